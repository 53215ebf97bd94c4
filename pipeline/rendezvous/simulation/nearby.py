"""The solids that a robot can touch, and geoms in MuJoCo's scene for just those."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from rendezvous.floorplan.records import Shape, Solid
from rendezvous.geometry.se2 import Array
from rendezvous.simulation.headless_mujoco import mujoco
from rendezvous.simulation.world import SLOT_Z_M

CELL_M = 0.25

_PARKED = (-1,)


class Nearby:
    """The solids within reach of each cell of a grid over the floor.

    Args:
        solids: walls and furniture.
        reach_m: a solid is near a cell if it is within this distance of one of its points.
    """

    def __init__(self, solids: Sequence[Solid], *, reach_m: float) -> None:
        self._near: dict[tuple[int, int], list[int]] = {}
        for index, solid in enumerate(solids):
            for cell in _cells_near(solid, reach_m):
                self._near.setdefault(cell, []).append(index)
        self.most = max((len(near) for near in self._near.values()), default=0)
        """The largest number of solids near one cell."""

    def solids_at(self, poses_w: Array) -> tuple[int, ...]:
        """Indices, ascending, of the solids near any of the points (R, 2 or more) [m]."""
        near: set[int] = set()
        for x_m, y_m in poses_w[:, :2].tolist():
            near.update(self._near.get((math.floor(y_m / CELL_M), math.floor(x_m / CELL_M)), ()))
        return tuple(sorted(near))


def _cells_near(solid: Solid, reach_m: float) -> list[tuple[int, int]]:
    """Cells whose centre is within reach, and half a cell's diagonal, of the footprint."""
    corners_m = solid.corners_m()
    margin_m = reach_m + CELL_M
    col0, row0 = np.floor((corners_m.min(axis=0) - margin_m) / CELL_M).astype(int)
    col1, row1 = np.floor((corners_m.max(axis=0) + margin_m) / CELL_M).astype(int)
    rows, cols = np.mgrid[row0 : row1 + 1, col0 : col1 + 1]
    centres_m = np.stack([(cols + 0.5) * CELL_M, (rows + 0.5) * CELL_M], axis=-1)
    outside_m = np.abs(solid.T_w_s().inverse() @ centres_m) - (solid.half_x_m, solid.half_y_m)
    near = np.hypot(*np.moveaxis(np.maximum(outside_m, 0.0), -1, 0)) <= reach_m + CELL_M * math.sqrt(0.5)
    return list(zip(rows[near].tolist(), cols[near].tolist(), strict=True))


class Slots:
    """The geoms `slot0`, `slot1`, ... of a model, which can take the place of solids.

    Args:
        model: from `scene_mjcf` with slots.
        solids: all that can be put into them.
    """

    def __init__(self, model: Any, solids: Sequence[Solid]) -> None:
        self._model = model
        self._solids = solids
        names = [model.geom(geom).name for geom in range(model.ngeom)]
        self._geoms = [geom for geom, name in enumerate(names) if name.startswith("slot")]
        self._filled: tuple[int, ...] = _PARKED
        # The tree of bounding boxes is built once, around the parked slots.
        if self._geoms:
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MIDPHASE

    def fill(self, indices: tuple[int, ...]) -> None:
        """Put just these solids into the scene."""
        if indices == self._filled:
            return
        self._filled = indices
        for slot, geom in enumerate(self._geoms):
            if slot < len(indices):
                self._place(geom, self._solids[indices[slot]])
            else:
                self._model.geom_pos[geom] = (0.0, 0.0, SLOT_Z_M)

    def _place(self, geom: int, solid: Solid) -> None:
        model, half_z_m = self._model, 0.5 * (solid.z1_m - solid.z0_m)
        is_box = solid.shape is Shape.BOX
        model.geom_type[geom] = mujoco.mjtGeom.mjGEOM_BOX if is_box else mujoco.mjtGeom.mjGEOM_CYLINDER
        half_m = (solid.half_x_m, solid.half_y_m, half_z_m)
        model.geom_size[geom] = half_m if is_box else (solid.half_x_m, half_z_m, 0.0)
        model.geom_pos[geom] = (solid.x_m, solid.y_m, solid.z0_m + half_z_m)
        model.geom_quat[geom] = (math.cos(0.5 * solid.yaw_rad), 0.0, 0.0, math.sin(0.5 * solid.yaw_rad))
        model.geom_aabb[geom] = (0.0, 0.0, 0.0, *half_m)
        model.geom_rbound[geom] = math.hypot(*half_m) if is_box else math.hypot(solid.half_x_m, half_z_m)
        # The compiler marks geoms whose frame is their body's; that no longer holds.
        model.geom_sameframe[geom] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
