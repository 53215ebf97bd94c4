"""How large and how frequent defects are: their draws against the ranges that their descriptions name."""

from __future__ import annotations

import numpy as np
import pytest

from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2
from rendezvous.training.frame_error import defects
from rendezvous.training.frame_error.defects import patched, ragged, rescanned, specked, with_spurious_rays

CELL_M = 0.1


def rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def filled(value: int) -> OccupancyGrid:
    """20 m by 20 m of one kind of cells."""
    return OccupancyGrid(
        cells=np.full((200, 200), value, np.uint8), resolution_m=CELL_M, T_m_g=SE2.identity()
    )


def spans(values: list[float], low: float, high: float) -> bool:
    """Whether values lie from low to high, and come near both ends."""
    near = 0.1 * (high - low)
    return low <= min(values) <= low + near and high - near <= max(values) <= high


@pytest.fixture
def traced(monkeypatch: pytest.MonkeyPatch) -> list[np.ndarray]:
    """The rays that a defect traces: row, col, bearing, range and distance beyond a wall [cells]."""
    rays: list[np.ndarray] = []
    monkeypatch.setattr(defects, "_traced", lambda grid, found, **_: rays.append(found))
    return rays


def scans(rays: np.ndarray) -> list[np.ndarray]:
    """Bearings by the place from which rays start."""
    return [rays[(rays[:, :2] == start).all(axis=1), 2] for start in np.unique(rays[:, :2], axis=0)]


def test_scans_are_those_of_lidars_on_small_robots(traced):
    for seed in range(120):
        rescanned(filled(FREE), rng(seed))
    assert spans([CELL_M * rays[0, 3] for rays in traced], 4.0, 12.0)
    assert all(np.ptp(rays[:, 3]) == 0.0 for rays in traced)
    by_map = [scans(rays) for rays in traced]
    assert {len(found) for found in by_map} == {*range(4, 17)}
    view_deg = [max(np.degrees(np.ptp(scan)) for scan in found) for found in by_map]
    assert spans(view_deg, 175.0, 360.0)  # the outermost beams may not have come back
    gap_deg = [np.degrees(np.diff(np.sort(found[0])).min()) for found in by_map]
    assert spans(gap_deg, 0.35, 1.53)  # a view holds a whole number of gaps
    sent = [round(view / gap) + 1 for view, gap in zip(view_deg, gap_deg, strict=True)]
    lost = [
        1.0 - len(rays) / (beams * len(found))
        for rays, beams, found in zip(traced, sent, by_map, strict=True)
    ]
    assert 0.17 < np.mean(lost) < 0.23
    through = [(rays[:, 4] > 0.0).mean() for rays in traced]
    assert 0.02 < max(through) < 0.08  # of the beams that came back
    beyond_m = [CELL_M * rays[:, 4].max() for rays in traced if rays[:, 4].any()]
    assert spans(beyond_m, 0.5, 5.0)


def test_fans_through_walls_are_as_wide_as_told(traced):
    for seed in range(100):
        with_spurious_rays(filled(FREE), rng(seed))
    by_map = [scans(rays) for rays in traced]
    assert {len(found) for found in by_map} == {*range(1, 7)}
    assert all(len(fan) == 24 for found in by_map for fan in found)
    assert spans([float(np.degrees(np.ptp(fan))) for found in by_map for fan in found], 1.0, 12.0)
    assert all((rays[:, 3] * CELL_M == pytest.approx(12.0)) for rays in traced)
    assert spans([CELL_M * rays[0, 4] for rays in traced], 0.5, 5.0)


def test_specks_are_as_frequent_as_told():
    found = [specked(filled(FREE), rng(seed)).cells for seed in range(40)]
    assert spans([float((cells == UNKNOWN).mean()) for cells in found], 0.0, 0.03)
    assert spans([float((cells == OCCUPIED).mean()) for cells in found], 0.0, 0.002)


def test_patches_are_as_large_as_told():
    lost_m2 = [CELL_M**2 * (patched(filled(FREE), rng(seed)).cells == UNKNOWN).sum() for seed in range(200)]
    # One to five; discs of 0.2 to 1 m and wedges of 0.5 to 5 m have 1.3 m² each on average; some at the rim.
    assert 3.0 < np.mean(lost_m2) < 4.0
    assert max(lost_m2) < 5 * 6.3


def test_a_fifth_of_the_wall_suffers_much_more_than_the_rest():
    lost = []
    for seed in range(6):
        blocks = (ragged(filled(OCCUPIED), rng(seed)).cells != OCCUPIED)[:198, :198].reshape(33, 6, 33, 6)
        lost.append(blocks.mean(axis=(1, 3)).ravel())
    # Uniform from 0.2 to 0.9 in a fifth, from 0 to 0.25 elsewhere; what grows fills a little of it again.
    assert 0.08 < np.mean(np.concatenate(lost) > 0.4) < 0.17
    assert 0.08 < np.median(np.concatenate(lost)) < 0.18
