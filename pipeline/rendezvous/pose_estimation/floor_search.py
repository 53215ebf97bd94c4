"""Exhaustive search for poses on the floor that belief maps support.

Each peak of any map is an anchor: one point of the cuboid may be there. For every anchor, heading and
distance along the anchor's ray, the other eight points follow, and the maps are read there. A robot that
would then stand above or below the floor is penalised by how much the camera may lean. Secondary peaks,
hidden points and confusion of front and back need no special treatment.

Legend: A anchors, H headings, D distances, M states of an `ObservationModel`.
"""

from __future__ import annotations

import numpy as np

from rendezvous.compiled import njit
from rendezvous.geometry.occupancy_grid import Mask
from rendezvous.geometry.se2 import Array
from rendezvous.pose_estimation.dope_labels import Maps
from rendezvous.pose_estimation.look import STRIDE_PX, Look
from rendezvous.pose_estimation.observation_model import HEIGHT_SIGMA_M, TILT_SIGMA_RAD, ObservationModel
from rendezvous.pose_estimation.peaks import Peaks

HEADINGS = 72
DISTANCES_M = tuple(float(d) for d in np.geomspace(0.2, 8.0, 64))
ANCHORS = 18
_BASE = 0.02  # belief where a map is zero
_KEPT = 12
_APART_HEADING_RAD, _APART_SHARE = 0.3, 0.12
"""Poses closer than this in heading and position count as one; the position's limit is a share of the
distance."""


def floor_poses(model: ObservationModel, look: Look, belief_9hw: Maps, peaks: Peaks) -> Array:
    """(M, 6) states that the maps support, the best first, no two alike.

    Args:
        model: camera and robot.
        look: the part of the image that the maps cover.
        belief_9hw: belief maps.
        peaks: their maxima.
    """
    anchors = np.argsort(-peaks.height_P, kind="stable")[:ANCHORS]
    uv_px = look.to_image(STRIDE_PX * peaks.uv_cells_P2[anchors])
    camera = model.camera
    rays_c = np.column_stack(
        [
            (uv_px[:, 0] - camera.cx_px) / camera.fx_px,
            (uv_px[:, 1] - camera.cy_px) / camera.fy_px,
            np.ones(len(anchors)),
        ]
    )
    headings = np.arange(HEADINGS) * (2.0 * np.pi / HEADINGS)
    c, s = np.cos(headings), np.sin(headings)
    q = model.robot.points_r1()
    turned_r0 = np.stack(
        [
            np.outer(c, q[:, 0]) - np.outer(s, q[:, 1]),
            np.outer(s, q[:, 0]) + np.outer(c, q[:, 1]),
            np.tile(q[:, 2], (HEADINGS, 1)),
        ],
        axis=2,
    )
    R_r0_c = model.T_r0_c[:3, :3]
    score_AHD = _scores(
        np.log(np.maximum(belief_9hw, 0.0).astype(np.float32) + _BASE) - np.log(np.float32(_BASE)),
        rays_c,
        peaks.channel_P[anchors],
        turned_r0 @ R_r0_c,
        np.array(DISTANCES_M),
        _pixels_to_cells(model, look),
        _heights(model, rays_c),
        q[:, 2].copy(),
    )
    order = np.argsort(-score_AHD, axis=None)[: 40 * _KEPT]
    anchor, heading, distance = np.unravel_index(order, score_AHD.shape)
    at_r0 = np.array(DISTANCES_M)[distance, None] * (rays_c[anchor] @ R_r0_c.T) + model.T_r0_c[:3, 3]
    base = at_r0 - turned_r0[heading, peaks.channel_P[anchors][anchor]]
    states = np.column_stack([base[:, :2], headings[heading], np.zeros((len(order), 3))])
    good = np.isfinite(score_AHD.ravel()[order])
    return _apart(states[good])


def _pixels_to_cells(model: ObservationModel, look: Look) -> Array:
    """(4,) from a direction (x / z, y / z) to cells: factor and offset of the column, then of the row."""
    camera, scale = model.camera, look.scale / STRIDE_PX
    (du, dv) = look.offset_px
    return np.array(
        [
            scale * camera.fx_px,
            scale * camera.cx_px + du / STRIDE_PX,
            scale * camera.fy_px,
            scale * camera.cy_px + dv / STRIDE_PX,
        ]
    )


def _heights(model: ObservationModel, rays_c: Array) -> Array:
    """(A, 2) height of a ray's point above the floor: metres per metre of depth, and at depth 0 [m]."""
    up = rays_c @ model.T_r0_c[2, :3]
    return np.column_stack([up, np.full(len(up), model.T_r0_c[2, 3])])


@njit(error_model="numpy")
def _scores(  # type: ignore[no-untyped-def]
    gain_9hw, rays_A3, channel_A, turned_H93, depths_D, to_cells, heights_A2, z_9
):
    """(A, H, D) log belief gained minus the floor's penalty; -inf behind the camera."""
    _, rows, cols = gain_9hw.shape
    out = np.full((len(rays_A3), len(turned_H93), len(depths_D)), -np.inf)
    for a in range(len(rays_A3)):
        for d in range(len(depths_D)):
            depth = depths_D[d]
            above = heights_A2[a, 0] * depth + heights_A2[a, 1] - z_9[channel_A[a]]
            variance = HEIGHT_SIGMA_M**2 + (TILT_SIGMA_RAD * depth) ** 2
            against = 0.5 * above**2 / variance
            if against > 12.0:
                continue
            for h in range(len(turned_H93)):
                points = turned_H93[h]
                score, ahead = -against, True
                for k in range(9):
                    x = rays_A3[a, 0] * depth + points[k, 0] - points[channel_A[a], 0]
                    y = rays_A3[a, 1] * depth + points[k, 1] - points[channel_A[a], 1]
                    z = depth + points[k, 2] - points[channel_A[a], 2]
                    if z < 0.05:
                        ahead = False
                        break
                    u = to_cells[0] * x / z + to_cells[1]
                    v = to_cells[2] * y / z + to_cells[3]
                    col, row = int(np.floor(u)), int(np.floor(v))
                    if col < 0 or row < 0 or col + 1 >= cols or row + 1 >= rows:
                        continue
                    fu, fv = u - col, v - row
                    gain = gain_9hw[k]
                    score += (1.0 - fv) * ((1.0 - fu) * gain[row, col] + fu * gain[row, col + 1])
                    score += fv * ((1.0 - fu) * gain[row + 1, col] + fu * gain[row + 1, col + 1])
                if ahead:
                    out[a, h, d] = score
    return out


def _apart(states_M6: Array) -> Array:
    """The first of each group that counts as one."""
    left, kept = states_M6, list[Array]()
    while len(left) and len(kept) < _KEPT:
        kept.append(left[0])
        left = left[~same_place(left, left[0], _APART_SHARE, _APART_HEADING_RAD)]
    return np.array(kept).reshape(-1, 6)


def same_place(states_M6: Array, one_6: Array, share: float, heading_rad: float) -> Mask:
    """(M,) which states are close to one in heading and position; `share` is relative to its distance."""
    turn = np.abs(np.remainder(states_M6[:, 2] - one_6[2] + np.pi, 2.0 * np.pi) - np.pi)
    away = np.hypot(states_M6[:, 0] - one_6[0], states_M6[:, 1] - one_6[1])
    same: Mask = (turn < heading_rad) & (away < share * np.hypot(one_6[0], one_6[1]))
    return same
