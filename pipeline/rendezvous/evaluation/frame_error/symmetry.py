"""Scenes that look much the same when turned, where maps alone hardly distinguish headings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import pandas as pd
from scipy import fft

from rendezvous.evaluation.frame_error.summary import Accuracy, accuracy
from rendezvous.evaluation.json_record import JsonRecord
from rendezvous.geometry.occupancy_grid import Mask, OccupancyGrid
from rendezvous.geometry.se2 import Array

SYMMETRIC_SHARE = 0.6
"""The least share of a symmetric map. What a robot has seen repeats only in part: of 150 test pairs half are
above 0.42, 6 reach this, and none reaches 0.85."""
TOLERANCE_M = 0.10
WIDE_RANGE_DEG = 90.0
"""Frame errors of a smaller range cannot confuse a map with itself turned."""


def turn_symmetry(grid: OccupancyGrid, *, tolerance_m: float = TOLERANCE_M) -> float:
    """The largest share of a map's walls, in [0, 1], that lie on its walls after a turn.

    Turns are of 90, 180 and 270 degrees about any point. A square room has 1, a map without walls 0.

    Args:
        grid: the map.
        tolerance_m: a wall cell lies on another if their centres are no farther apart.
    """
    walls = grid.occupied()
    if not walls.any():
        return 0.0
    reach = int(tolerance_m / grid.resolution_m + 1e-9)
    offsets = np.arange(-reach, reach + 1)
    disk = (np.hypot(offsets[:, None], offsets) <= reach).astype(np.uint8)
    near = cv2.dilate(np.pad(walls, reach).astype(np.uint8), disk)
    best = max(_most_overlap(near, np.rot90(walls, turns)) for turns in (1, 2, 3))
    return float(best / walls.sum())


def _most_overlap(near: Mask, walls: Mask) -> float:
    """The largest number of walls that lie on a mask, over all shifts."""
    shape = [fft.next_fast_len(a + b - 1, real=True) for a, b in zip(near.shape, walls.shape, strict=True)]
    # A convolution with the walls upside down is their correlation.
    counts = fft.irfft2(fft.rfft2(near, shape) * fft.rfft2(walls[::-1, ::-1], shape), shape)
    return float(counts.max().round())


@dataclass(frozen=True, slots=True, kw_only=True)
class Apart(JsonRecord):
    """Errors on pairs with a symmetric map and on the others; None where there are none."""

    symmetric: Accuracy | None
    others: Accuracy | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Symmetry:
    """How symmetric the measured pairs are, and the errors of methods on them."""

    share: Array  # (N,) `turn_symmetry` of each pair's map 1
    methods: Mapping[str, Apart]  # by name

    @staticmethod
    def of(share: Array, outcomes: pd.DataFrame, weights: Array) -> Symmetry:
        """From an `outcome_table` of N pairs, and (R, N) weights of the resamples."""
        methods = {}
        for name, rows in outcomes.groupby("method", sort=False):
            symmetric = share[rows.index] >= SYMMETRIC_SHARE
            methods[str(name)] = Apart(
                symmetric=_accuracy(rows[symmetric], weights), others=_accuracy(rows[~symmetric], weights)
            )
        return Symmetry(share=share, methods=methods)

    @property
    def count(self) -> int:
        """Number of pairs with a symmetric map."""
        return int((self.share >= SYMMETRIC_SHARE).sum())

    @property
    def median(self) -> float:
        """The median share."""
        return float(np.median(self.share))

    def to_json(self) -> dict[str, Any]:
        """JSON values."""
        methods = {name: apart.to_json() for name, apart in self.methods.items()}
        return {"symmetric_share": SYMMETRIC_SHARE, "symmetric_pairs": self.count, "methods": methods}


def _accuracy(rows: pd.DataFrame, weights: Array) -> Accuracy | None:
    return accuracy(rows, weights) if len(rows) else None
