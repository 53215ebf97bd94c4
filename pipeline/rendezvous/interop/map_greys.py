"""Maps whose greys and thresholds do not belong together.

map_saver draws unknown cells in grey 205, `p = 0.196`. A `free_thresh` of 0.25 or a stretched contrast frees
them all. RTAB-Map draws occupied, unknown and free cells in 0, 89 and 178, which the usual thresholds read as
occupied, occupied and unknown.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from rendezvous.errors import MapError
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, Cells, Mask

Counts = NDArray[np.int64]

NEAR, AROUND, SHARE, FEWEST = 5, 12, 0.7, 16
"""A grey stands out if of the cells within `AROUND` greys of it at least `SHARE` are within `NEAR`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Thresholds:
    """How a map's YAML file has its greys read."""

    # occupied, free: probabilities above which a cell is occupied, below which it is free.
    occupied: float
    free: float
    negate: bool  # whether white is occupied


@dataclass(frozen=True, slots=True, kw_only=True)
class _Greys:
    """A histogram of brightness."""

    counts: Counts  # (256,) number of visible cells; `free`, `occupied`: of those read as free, as occupied
    free: Counts
    occupied: Counts
    standing_out: tuple[int, ...]  # brightnesses that stand out, darkest first

    def mostly(self, brightness: int, of: Counts) -> bool:
        return 2 * _within(of, brightness) > _within(self.counts, brightness)

    def share(self, brightness: int) -> float:
        return _within(self.counts, brightness) / self.counts.sum()


def keep_meaning(
    cells_in_place: Cells, brightness: NDArray[np.uint8], visible: Mask, thresholds: Thresholds, source: Path
) -> None:
    """Reset to unknown, with a warning, the unknown cells that the thresholds free.

    Args:
        cells_in_place: (H, W) as read by the thresholds.
        brightness: (H, W) from 0 to 255; already inverted for a negated map, so that free cells are bright.
        visible: (H, W) False for transparent pixels.
        thresholds: of the map.
        source: the map's YAML file.

    Raises:
        MapError: the brightest of its greys is not free.
    """
    greys = _greys_of(cells_in_place, brightness, visible)
    _require_free(greys, thresholds, source)
    unknown = _freed_unknown(greys)
    if unknown is not None:
        freed = (brightness <= _upper_end(greys.counts, unknown)) & (cells_in_place == FREE) & visible
        cells_in_place[freed] = UNKNOWN
        warnings.warn(
            f"{source}: free_thresh {thresholds.free} makes grey {_stored(unknown, thresholds)}, unknown in "
            f"a trinary map, free; its {int(freed.sum()):,} cells are read as unknown (--strict: as free)",
            stacklevel=4,
        )
    _warn_of_walls(greys, thresholds, source)


def _greys_of(cells: Cells, brightness: NDArray[np.uint8], visible: Mask) -> _Greys:
    counts, free, occupied = (
        cv2.calcHist([brightness], [0], mask.astype(np.uint8), [256], [0, 256]).ravel().astype(np.int64)
        for mask in (visible, visible & (cells == FREE), visible & (cells == OCCUPIED))
    )
    near, around = (np.convolve(counts, np.ones(2 * n + 1, np.int64), "same") for n in (NEAR, AROUND))
    standing_out = tuple(
        g
        for g in range(256)
        if near[g] >= max(FEWEST, SHARE * around[g]) and g == _highest(counts, g - AROUND, g + AROUND)
    )
    return _Greys(counts=counts, free=free, occupied=occupied, standing_out=standing_out)


def _freed_unknown(greys: _Greys) -> int | None:
    """Brightness of unknown cells that are read as free; None if there are none.

    This is map_saver's 205, which rescaling may move by one, if it stands out below the brightest grey or has
    most of the cells that are neither black nor white. Otherwise it is the most common grey that stands out
    below the brightest and is read as free, unless one that is read as unknown is more common.
    """
    counts, own = greys.counts, slice(UNKNOWN - 1, UNKNOWN + 2)
    brightest = max(greys.standing_out, default=0)
    freed = [g for g in greys.standing_out if g < brightest and greys.mostly(g, greys.free)]
    unknown = [
        g for g in greys.standing_out if not (greys.mostly(g, greys.free) or greys.mostly(g, greys.occupied))
    ]
    if 2 * greys.free[own].sum() > counts[own].sum():
        most_common = 2 * counts[own].sum() > counts[2:254].sum()
        grey = _highest(counts, own.start, own.stop - 1)
        if grey in freed or (most_common and not (grey == brightest and unknown)):
            return grey
    most = max(freed, key=greys.share, default=None)
    if most is None or any(greys.share(g) > greys.share(most) for g in unknown):
        return None
    return most


def _require_free(greys: _Greys, thresholds: Thresholds, source: Path) -> None:
    """Refuse a map whose brightest grey is not free, unless it has only walls and a usual unknown grey."""
    if len(greys.standing_out) < 2:
        return
    *_, brightest = greys.standing_out
    usual = brightest in (127, 128, UNKNOWN) and len(greys.standing_out) == 2
    if greys.mostly(brightest, greys.free) or usual:
        return
    raw = "; if they are per cent, write mode: raw" if brightest <= 100 and not thresholds.negate else ""
    raise MapError(
        f"{source}: none of its greys is free by free_thresh {thresholds.free}: "
        f"{_listed(greys, thresholds)}; if they are occupied{', unknown' * (len(greys.standing_out) > 2)} "
        f"and free, as RTAB-Map draws them, write {_right(greys, thresholds)}{raw}; --strict reads it as is"
    )


def _warn_of_walls(greys: _Greys, thresholds: Thresholds, source: Path) -> None:
    """Warn of a grey that is read as occupied beside a darker one with fewer cells: it may be unknown."""
    darkest, *others = greys.standing_out or (0,)
    more = [g for g in others if greys.mostly(g, greys.occupied) and greys.share(g) > greys.share(darkest)]
    if more and greys.mostly(darkest, greys.occupied):
        warnings.warn(
            f"{source}: grey {_stored(more[-1], thresholds)} is occupied by occupied_thresh "
            f"{thresholds.occupied}: {_listed(greys, thresholds)}; if it is unknown, write "
            f"{_right(greys, thresholds)}",
            stacklevel=4,
        )


def _listed(greys: _Greys, thresholds: Thresholds) -> str:
    return ", ".join(f"{_stored(g, thresholds)} ({greys.share(g):.1%})" for g in greys.standing_out)


def _right(greys: _Greys, thresholds: Thresholds) -> str:
    """Thresholds half-way between the greys that stand out."""
    darkest, *between, brightest = greys.standing_out
    middle = [max(between, key=greys.share)] if between else []
    probability = 1.0 - np.array([darkest, *middle, brightest]) / 255.0
    halves = (probability[1:] + probability[:-1]) / 2.0
    return f"occupied_thresh: {halves[0]:.2f} and free_thresh: {halves[-1]:.2f}"


def _stored(brightness: int, thresholds: Thresholds) -> int:
    """The grey in the image, scaled to 8 bits."""
    return 255 - brightness if thresholds.negate else brightness


def _within(counts: Counts, brightness: int) -> int:
    return int(counts[max(brightness - NEAR, 0) : brightness + NEAR + 1].sum())


def _highest(counts: Counts, low: int, high: int) -> int:
    """The most common brightness from low to high; the first of several."""
    low = max(low, 0)
    return low + int(np.argmax(counts[low : high + 1]))


def _upper_end(counts: Counts, brightness: int) -> int:
    """The brightest that noise makes of a grey: it still has a twentieth of the grey's cells."""
    end = brightness
    while end < brightness + NEAR and 20 * counts[end + 1] >= counts[brightness] > 0:
        end += 1
    return end
