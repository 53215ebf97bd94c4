"""A scene that changes between two visits: furniture moved, removed and added."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rendezvous.floorplan.furnish import Placed
from rendezvous.floorplan.records import Floorplan, Solid
from rendezvous.floorplan.site import CELL_M, Site
from rendezvous.geometry.se2 import Array

_TRIES = 20  # places tried for one piece
_MOVED_M = (0.3, 2.0)
_, _MOVED, _REPLACED = range(3)  # the first: removed


def changed_furniture(
    floorplan: Floorplan,
    pieces: Sequence[Placed],
    rng: np.random.Generator,
    *,
    share: float,
    robot_radius_m: float,
) -> tuple[Solid, ...]:
    """The furniture after this share of its pieces was removed, moved, or replaced by another one elsewhere.

    What stays has the same solids as before. A robot still gets everywhere, as after `furnish`; a piece that
    finds no place is gone.

    Args:
        floorplan: a validated plan.
        pieces: the furniture before, as `arranged` gives it.
        rng: draws what changes, and how.
        share: of the pieces, 0 to 1.
        robot_radius_m: radius of the robot that has to get around.
    """
    site = Site(floorplan, robot_radius_m=robot_radius_m)
    # Uniform: which pieces change, and what happens to each of them.
    chosen = rng.permutation(len(pieces))[: round(share * len(pieces))]
    kinds = dict(zip(chosen.tolist(), rng.integers(3, size=len(chosen)).tolist(), strict=True))
    after = [
        placed
        for i, placed in enumerate(pieces)
        if i not in kinds and site.place_in_place(placed.piece, placed.pose[None]) is not None
    ]
    for i, kind in kinds.items():
        if kind == _MOVED:
            after += _put(site, pieces[i], _near(pieces[i].pose, rng))
        elif kind == _REPLACED:
            # One like any other in the building, anywhere.
            like = pieces[int(rng.integers(len(pieces)))]
            after += _put(site, replace(like, item=len(pieces) + i), _anywhere(site, like.pose, rng))
    return tuple(solid for placed in after for solid in placed.solids())


def _put(site: Site, placed: Placed, poses: Array) -> list[Placed]:
    """The piece at the first of these poses at which it fits, if any."""
    pose = site.place_in_place(placed.piece, poses)
    return [] if pose is None else [replace(placed, pose=pose)]


def _near(pose: Array, rng: np.random.Generator) -> Array:
    """(T, 3) poses a little away, turned a little, one in four by a right angle."""
    away_m = rng.uniform(*_MOVED_M, size=_TRIES)
    towards_rad = rng.uniform(-math.pi, math.pi, size=_TRIES)
    turned_rad = rng.normal(0.0, 0.15, size=_TRIES)
    turned_rad += 0.5 * math.pi * (rng.random(_TRIES) < 0.25)
    return pose + np.column_stack([away_m * np.cos(towards_rad), away_m * np.sin(towards_rad), turned_rad])


def _anywhere(site: Site, pose: Array, rng: np.random.Generator) -> Array:
    """(T, 3) poses uniform over what the robot reaches, about square to the one given."""
    cells = np.argwhere(site.reachable)
    row_col = cells[rng.integers(len(cells), size=_TRIES)]
    xy_m = site.origin_m + CELL_M * (row_col[:, ::-1] + rng.random((_TRIES, 2)))
    square_rad = pose[2] + 0.5 * math.pi * rng.integers(4, size=_TRIES)
    return np.column_stack([xy_m, square_rad + rng.normal(0.0, 0.06, size=_TRIES)])
