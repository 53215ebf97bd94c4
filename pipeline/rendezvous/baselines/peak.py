"""The score close to its best cell, between the cells: a finer estimate, and how certain it is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rendezvous.alignment.window import OCCUPIED_CELL, MapWindow
from rendezvous.baselines.correlation import SCORE_SCALE, Field, likelihood_field
from rendezvous.compiled import njit
from rendezvous.geometry.se2 import SE2, Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Peak:
    """The scores around a motion, read as a posterior.

    Attributes:
        mean: its mean.
        covariance: (3, 3) of the components x [m], y [m], yaw [rad] of `mean⁻¹ θ`.
    """

    mean: SE2
    covariance: Array


def peak_around(
    theta: SE2,
    window: MapWindow,
    *,
    blur_m: float,
    free_penalty: float,
    step_m: float,
    step_rad: float,
    steps_xy: int,
    steps_yaw: int,
    temperature: float,
) -> Peak:
    """Mean and covariance of the scores in a small box around a motion.

    The posterior of a cell is `exp(score / temperature)`: neighbouring walls err together, so the
    temperature is far above 1.

    Args:
        theta: the box's centre.
        window: both maps, at the cell at which to score.
        blur_m, free_penalty: as in `correlation`.
        step_m, step_rad: size of the box's cells.
        steps_xy, steps_yaw: cells from the centre to the border of the box.
        temperature: in wall cells.
    """
    box = _box(step_m, step_rad, steps_xy, steps_yaw)
    scores = motion_scores(_composed(theta, box), window, blur_m=blur_m, free_penalty=free_penalty)
    weights = np.exp((scores - scores.max()) / temperature)
    weights /= weights.sum()
    to_mean = SE2.from_array(weights @ box)
    offsets = _composed(to_mean.inverse(), box)
    # What is finer than the box's cells is uniform within them.
    within = np.diag(np.array([step_m, step_m, step_rad]) ** 2 / 12.0)
    covariance = (weights[:, None] * offsets).T @ offsets + within
    return Peak(mean=(theta @ to_mean).wrapped(), covariance=covariance)


def _box(step_m: float, step_rad: float, steps_xy: int, steps_yaw: int) -> Array:
    """(B, 3) small motions on a grid around the identity."""
    xy, yaw = np.arange(-steps_xy, steps_xy + 1) * step_m, np.arange(-steps_yaw, steps_yaw + 1) * step_rad
    return np.stack(np.meshgrid(xy, xy, yaw, indexing="ij"), axis=-1).reshape(-1, 3)


def _composed(first: SE2, motions: Array) -> Array:
    """(M, 3): `first @ motion` for motions (M, 3)."""
    return np.column_stack([first @ motions[:, :2], first.yaw_rad + motions[:, 2]])


def _inverses(motions: Array) -> Array:
    """(M, 3): of motions (M, 3)."""
    (x, y), yaw_rad = motions[:, :2].T, motions[:, 2]
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.column_stack([-c * x - s * y, s * x - c * y, -yaw_rad])


def motion_scores(thetas: Array, window: MapWindow, *, blur_m: float, free_penalty: float) -> Array:
    """(M,) scores of motions (M, 3), in wall cells; fields are read bilinearly, so motions need no grid."""
    fields = [
        likelihood_field(cells, blur_cells=blur_m / window.cell_m, free_penalty=free_penalty)
        for cells in window.cells
    ]
    centre = 0.5 * window.cells.shape[1] - 0.5
    walls = [
        (np.argwhere(cells == OCCUPIED_CELL)[:, ::-1] - centre) * window.cell_m for cells in window.cells
    ]
    total = _scores(_inverses(thetas), fields[0], walls[1], window.cell_m)
    total += _scores(thetas, fields[1], walls[0], window.cell_m)
    return total / SCORE_SCALE


@njit
def _scores(motions: Array, field: Field, points_m: Array, cell_m: float) -> Array:
    """(M,): for each motion, the sum of the field at the moved points (P, 2)."""
    size, centre = field.shape[0], 0.5 * field.shape[0] - 0.5
    out = np.zeros(len(motions))
    for m in range(len(motions)):
        c, s = math.cos(motions[m, 2]) / cell_m, math.sin(motions[m, 2]) / cell_m
        x0, y0 = centre + motions[m, 0] / cell_m, centre + motions[m, 1] / cell_m
        for i in range(len(points_m)):
            x = x0 + c * points_m[i, 0] - s * points_m[i, 1]
            y = y0 + s * points_m[i, 0] + c * points_m[i, 1]
            col, row = math.floor(x), math.floor(y)
            if 0 <= row < size - 1 and 0 <= col < size - 1:
                u, v = x - col, y - row
                low = (1.0 - u) * field[row, col] + u * field[row, col + 1]
                high = (1.0 - u) * field[row + 1, col] + u * field[row + 1, col + 1]
                out[m] += (1.0 - v) * low + v * high
    return out
