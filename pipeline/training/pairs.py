"""Pairs of maps straight from the published shards."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from pipeline.errors import StoreError
from pipeline.geometry.occupancy_grid import OccupancyGrid, grid_from_png
from pipeline.geometry.se2 import SE2, Array
from pipeline.store.digest import content_digest
from pipeline.store.disk import Disk
from pipeline.store.read import StageReader

COLUMNS = (
    "pair_id",
    "plan_id",
    "plan_digest",
    "seed",
    "map_0",
    "map_1",
    "origin_0",
    "origin_1",
    "resolution_m",
    "T_m0_r0",
    "T_m1_r1",
    "T_m0_m1_local",
    "overlap",
)
_POSES = ("origin_0", "origin_1", "T_m0_r0", "T_m1_r1", "T_m0_m1_local")
SPLIT_NAMES = ("train", "validation", "test")
_SPLIT_FILE = re.compile(r"pairs/(train|validation|test)-[0-9]+-of-[0-9]+\.parquet")


@dataclass(frozen=True, slots=True, kw_only=True)
class MapPair:
    """Two maps of one place, and how they lie.

    Attributes:
        pair_id: unique name.
        grid_0, grid_1: each robot's map, in its own frame.
        T_m0_m1: the true pose of map 1 in map 0, which makes the maps agree where the robots meet.
        T_m1_r1: where robot 1 stands in its map.
        T_m0_r0: where robot 0 stands in its map as it sees robot 1; None if that is not known.
        overlap: |known_0 ∩ known_1| / |known_0 ∪ known_1| of the maps as they are stored.
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
        """Where robot 1 truly stands in map 0: the meeting point."""
        return self.T_m0_m1 @ self.T_m1_r1


class PairTable:
    """The pairs of one split. Maps stay compressed (5 kB a pair) and are decoded when they are asked for.

    Attributes:
        split: its name.
        table: `COLUMNS` of its rows.
    """

    def __init__(self, split: str, table: pa.Table) -> None:
        self.split = split
        self.table = table.combine_chunks()
        self._poses = {name: _numbers(self.table[name]) for name in _POSES}
        self._maps = [_pngs(self.table[name]) for name in ("map_0", "map_1")]
        self._pair_ids: list[str] = self.table["pair_id"].to_pylist()
        self._resolution_m = self.table["resolution_m"].to_numpy()
        self.overlap: Array = self.table["overlap"].to_numpy()

    def __len__(self) -> int:
        return len(self._pair_ids)

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

    def digest(self) -> str:
        """Of all that is read, independent of how it is stored."""
        return content_digest(self.table)

    def plan_digests(self) -> list[str]:
        """Of the floor plans that the pairs are from, sorted."""
        return sorted(self.table["plan_digest"].unique().to_pylist())

    def seeds(self) -> list[int]:
        """The root seeds that the pairs were made with."""
        return sorted(self.table["seed"].unique().to_pylist())


def read_pairs(reader: StageReader, split: str) -> PairTable:
    """The pairs of one split of the published dataset.

    Raises:
        StoreError: the folder holds no such split, or a file is missing or damaged or lacks a column.
    """
    names = [shard.name for shard in reader.shards()]
    splits = {name: found[1] for name in names if (found := _SPLIT_FILE.fullmatch(name))}
    tables = [_columns(reader, name) for name, its_split in splits.items() if its_split == split]
    rows = sum(table.num_rows for table in tables)
    if rows == 0:
        have = ", ".join(sorted(set(splits.values()))) or f"{len(names)} files without a split in their names"
        raise StoreError(
            f"{reader.root}: no pairs in pairs/{split}-*.parquet, found {have}; "
            f"must be a dataset with the splits that `rendezvous pack` writes"
        )
    return PairTable(split, pa.concat_tables(tables))


def pairs_per_split(reader: StageReader) -> dict[str, int]:
    """How many pairs each split of the published dataset has, as its manifest tells."""
    counts = dict.fromkeys(SPLIT_NAMES, 0)
    for shard in reader.shards():
        if found := _SPLIT_FILE.fullmatch(shard.name):
            counts[found[1]] += shard.rows
    return counts


def _columns(reader: StageReader, name: str) -> pa.Table:
    """`COLUMNS` of one file, in that order."""
    table = reader.table(name, columns=COLUMNS)
    for column in COLUMNS:
        if column not in table.column_names:
            raise StoreError(
                f"{Disk(reader.root).shown(name)}: has no column {column!r}; must be a file of pairs as "
                "`rendezvous pack` writes them"
            )
    return table.select(list(COLUMNS))


def _numbers(column: pa.ChunkedArray) -> Array:
    """(N, 3) of a column of fixed-size lists."""
    flat = pa.concat_arrays(column.chunks).flatten()
    return np.asarray(flat.to_numpy(), dtype=np.float64).reshape(-1, 3)


def _pngs(column: pa.ChunkedArray) -> pa.Array:
    return pa.concat_arrays(column.chunks).field("bytes")
