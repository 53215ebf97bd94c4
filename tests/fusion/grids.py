"""Maps to fuse: small, of any size, resolution and origin."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2

VALUES = np.array([OCCUPIED, UNKNOWN, FREE], np.uint8)

poses = st.builds(SE2, st.floats(-3, 3), st.floats(-3, 3), st.floats(-3.2, 3.2))


def drawn_grid(
    seed: int,
    *,
    height: int = 20,
    width: int = 30,
    resolution_m: float = 0.05,
    T_m_g: SE2 | None = None,
) -> OccupancyGrid:
    """A map whose cells are each occupied, unknown or free, alike often."""
    cells = np.random.default_rng(seed).choice(VALUES, (height, width))
    return OccupancyGrid(cells=cells, resolution_m=resolution_m, T_m_g=T_m_g or SE2(-0.75, 0.3, 0.0))


grids = st.builds(
    drawn_grid,
    st.integers(0, 999),
    height=st.integers(1, 24),
    width=st.integers(1, 24),
    resolution_m=st.sampled_from([0.03, 0.05, 0.1]),
    T_m_g=poses,
)


def constant_grid(value: int, *, like: OccupancyGrid) -> OccupancyGrid:
    """A map of one value."""
    return OccupancyGrid(
        cells=np.full_like(like.cells, value), resolution_m=like.resolution_m, T_m_g=like.T_m_g
    )


def shown(text: str, *, resolution_m: float = 1.0, T_m_g: SE2 | None = None) -> OccupancyGrid:
    """A map as it is drawn: `#` occupied, `.` free, `?` unknown; the last line is row 0."""
    value = {"#": OCCUPIED, ".": FREE, "?": UNKNOWN}
    rows = [[value[mark] for mark in line] for line in reversed(text.split())]
    return OccupancyGrid(
        cells=np.array(rows, np.uint8), resolution_m=resolution_m, T_m_g=T_m_g or SE2.identity()
    )
