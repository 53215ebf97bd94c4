"""Pairs of maps, read straight from the published shards."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from rendezvous.geometry.occupancy_grid import OccupancyGrid, grid_from_png
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.store.read import StageReader
from rendezvous.training.published_rows import SPLIT_NAMES as SPLIT_NAMES
from rendezvous.training.published_rows import PublishedRows, number_rows, read_split

_POSES = ("origin_0", "origin_1", "T_m0_r0", "T_m1_r1", "T_m0_m1_local")
_MAPS = ("map_0", "map_1")
COLUMNS = ("pair_id", "plan_id", "plan_digest", "seed", *_MAPS, *_POSES, "resolution_m", "overlap")


@dataclass(frozen=True, slots=True, kw_only=True)
class MapPair:
    """Two maps of one place, and their true alignment.

    Attributes:
        pair_id: unique name.
        grid_0, grid_1: each robot's map, in its own frame.
        T_m0_m1: the true pose of map 1 in map 0, under which the maps agree where the robots meet.
        T_m1_r1: robot 1's pose in its map.
        T_m0_r0: robot 0's pose in its map when it sees robot 1; None if unknown.
        overlap: |known_0 ∩ known_1| / |known_0 ∪ known_1| of the stored maps.
    """

    pair_id: str
    grid_0: OccupancyGrid
    grid_1: OccupancyGrid
    T_m0_m1: SE2
    T_m1_r1: SE2
    overlap: float
    T_m0_r0: SE2 | None = None

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
    return PairTable(split, pa.concat_tables(read_split(reader, "pairs", split, columns=COLUMNS)))
