"""Pairs of maps, read from the published shards, and wrong transforms between them.

A wrong transform is drawn anew for each training sample, and fixed for validation and evaluation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from rendezvous.alignment.frame_error import frame_error, perturbed
from rendezvous.alignment.window import (
    PAPER_XY_M,
    PAPER_YAW_RAD,
    WINDOW_CELL_M,
    WINDOW_CELLS,
    MapWindow,
    SearchRange,
    map_window,
)
from rendezvous.errors import require_within
from rendezvous.geometry.occupancy_grid import OccupancyGrid, grid_from_png
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.seeds import stream
from rendezvous.store.read import StageReader
from rendezvous.training.published_rows import SPLIT_NAMES as SPLIT_NAMES
from rendezvous.training.published_rows import PublishedRows, number_rows, read_split

_POSES = ("origin_0", "origin_1", "T_m0_r0", "T_m1_r1", "T_m0_m1_local")
_MAPS = ("map_0", "map_1")
COLUMNS = ("pair_id", "plan_id", "plan_digest", "seed", *_MAPS, *_POSES, "resolution_m", "overlap")


@dataclass(frozen=True, slots=True, kw_only=True)
class MapPair:
    """Two maps of one place, and their true alignment."""

    pair_id: str  # unique name
    # grid_0, grid_1: each robot's map, in its own frame.
    grid_0: OccupancyGrid
    grid_1: OccupancyGrid
    T_m0_m1: SE2  # the true pose of map 1 in map 0, under which the maps agree where the robots meet
    T_m1_r1: SE2  # robot 1's pose in its map
    overlap: float  # |known_0 ∩ known_1| / |known_0 ∪ known_1| of the stored maps
    T_m0_r0: SE2 | None = None  # robot 0's pose in its map when it sees robot 1; None if unknown

    @property
    def T_m0_r1(self) -> SE2:
        """Robot 1's true pose in map 0: the meeting point."""
        return self.T_m0_m1 @ self.T_m1_r1


class PairTable(PublishedRows):
    """The pairs of one split. Maps stay compressed (5 kB a pair) and are decoded on access."""

    def __init__(self, split: str, table: pa.Table) -> None:
        super().__init__(split, table.combine_chunks())
        self._poses = {name: number_rows(self.table[name], width=3) for name in _POSES}
        self._maps = [pa.concat_arrays(self.table[name].chunks).field("bytes") for name in _MAPS]
        self._pair_ids: list[str] = self.table["pair_id"].to_pylist()
        self._resolution_m = self.table["resolution_m"].to_numpy()
        self.overlap: Array = self.table["overlap"].to_numpy()

    def __getitem__(self, index: int) -> MapPair:
        grids = [
            grid_from_png(
                self._maps[i][index].as_py(),
                resolution_m=float(self._resolution_m[index]),
                T_m_g=SE2.from_array(self._poses[f"origin_{i}"][index]),
            )
            for i in (0, 1)
        ]
        return MapPair(
            pair_id=self._pair_ids[index],
            grid_0=grids[0],
            grid_1=grids[1],
            T_m0_m1=SE2.from_array(self._poses["T_m0_m1_local"][index]),
            T_m1_r1=SE2.from_array(self._poses["T_m1_r1"][index]),
            overlap=float(self.overlap[index]),
            T_m0_r0=SE2.from_array(self._poses["T_m0_r0"][index]),
        )


def read_pairs(dataset: StageReader | str | Path, split: str) -> PairTable:
    """The pairs of one split of the published dataset.

    Raises:
        StoreError: the folder holds no such split, or a file is missing or damaged or lacks a column.
    """
    reader = dataset if isinstance(dataset, StageReader) else StageReader(str(dataset), "pack")
    return PairTable(
        split,
        pa.concat_tables(
            read_split(reader, "pairs", split, columns=COLUMNS, finite=(*_POSES, "resolution_m"))
        ),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class PerturbationRange:
    """Range of the frame errors that are drawn.

    A `wide_share` of the samples is drawn from the wide range (for pose estimators that flip a robot's
    heading), the others from the paper's.
    """

    # xy_m, yaw_rad: half widths.
    xy_m: float = PAPER_XY_M
    yaw_rad: float = PAPER_YAW_RAD
    wide_share: float = 0.0  # share of samples drawn from the wide range instead
    # wide_xy_m, wide_yaw_rad: half widths of that.
    wide_xy_m: float = 3.0
    wide_yaw_rad: float = math.pi

    def __post_init__(self) -> None:
        require_within(
            self,
            xy_m=(0.0, 8.0),
            yaw_rad=(0.0, math.pi),
            wide_share=(0.0, 1.0),
            wide_xy_m=(0.0, 8.0),
            wide_yaw_rad=(0.0, math.pi),
        )

    def search(self) -> SearchRange:
        """The search that reaches every frame error that can be drawn."""
        wide = self.wide_share > 0.0
        return SearchRange.covering(
            xy_m=max(self.xy_m, self.wide_xy_m) if wide else self.xy_m,
            yaw_rad=max(self.yaw_rad, self.wide_yaw_rad) if wide else self.yaw_rad,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Perturbation:
    """A frame error at the meeting point in the axes of m0, and the heading of the window frame v in m0."""

    theta_c: SE2
    rotation_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PerturbedPair:
    """A pair under a wrong map transform, as an estimator sees it, and the truth."""

    window: MapWindow
    theta_v: SE2  # the true frame error in v
    T_estimated: SE2  # the wrong `T_m0_m1`
    T_m0_v: SE2


def draw_perturbation(range_: PerturbationRange, rng: np.random.Generator) -> Perturbation:
    """Uniform in x, y, yaw over one of the two ranges; the window's heading uniform over the circle."""
    wide = rng.random() < range_.wide_share
    xy_m, yaw_rad = (range_.wide_xy_m, range_.wide_yaw_rad) if wide else (range_.xy_m, range_.yaw_rad)
    x_m, y_m = rng.uniform(-xy_m, xy_m, 2)
    theta_c = SE2(float(x_m), float(y_m), float(rng.uniform(-yaw_rad, yaw_rad)))
    return Perturbation(theta_c=theta_c, rotation_rad=float(rng.uniform(-math.pi, math.pi)))


def evaluation_perturbation(pair_id: str, range_: PerturbationRange, *, seed: int) -> Perturbation:
    """The one perturbation of a pair with which every method is measured."""
    return draw_perturbation(range_, stream(seed, "evaluation", pair_id))


def perturbed_pair(
    pair: MapPair, perturbation: Perturbation, *, cells: int = WINDOW_CELLS, cell_m: float = WINDOW_CELL_M
) -> PerturbedPair:
    """Place map 1 wrongly and draw the window around where that puts robot 1."""
    T_estimated, T_m0_c = perturbed(pair.T_m0_m1, pair.T_m0_r1, perturbation.theta_c)
    T_m0_v = T_m0_c @ SE2(0.0, 0.0, perturbation.rotation_rad)
    return PerturbedPair(
        window=map_window(
            pair.grid_0, pair.grid_1, T_estimated, T_m0_v, T_m0_r0=pair.T_m0_r0, cells=cells, cell_m=cell_m
        ),
        theta_v=frame_error(T_estimated, pair.T_m0_m1, T_m0_v),
        T_estimated=T_estimated,
        T_m0_v=T_m0_v,
    )
