import numpy as np

from rendezvous.evaluation.pictures.canvas import View
from rendezvous.evaluation.pictures.map_panels import PairMaps, sampled
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2
from tests.synthetic import synthetic_row


def test_a_panel_has_the_maps_value_at_every_half_pixel():
    cells = np.random.default_rng(0).choice(np.array([OCCUPIED, UNKNOWN, FREE], np.uint8), (40, 31))
    grid = OccupancyGrid(cells=cells, resolution_m=0.05, T_m_g=SE2(-0.7, 0.4, 0.3))
    T_d_m, view = SE2(0.5, -0.2, 1.1), View(px_per_m=33.3, u0_px=41.0, v0_px=52.0)
    u, v = np.meshgrid(np.arange(180) / 2.0, np.arange(140) / 2.0)
    wanted = grid.sample(T_d_m.inverse() @ view.p_m(np.stack([u, v], axis=-1)))
    found = sampled(grid, T_d_m, view, (90, 70))
    assert len(np.unique(found)) == 3
    np.testing.assert_array_equal(found, wanted)


def test_maps_lie_as_they_agree_and_true_paths_as_the_robots_started():
    row = synthetic_row(np.random.default_rng(0), plan=0) | {"T_m0_m1": SE2(1.0, 2.0, 0.5)}
    pair = PairMaps.of(row)
    assert pair.T_m0_m(0) == pair.T_m0_m(0, true=True) == SE2.identity()
    assert pair.T_m0_m(1) == row["T_m0_m1_local"]
    assert pair.T_m0_m(1, true=True) == SE2(1.0, 2.0, 0.5)
