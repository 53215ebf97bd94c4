import math

import numpy as np
from pytest import approx

from rendezvous.alignment.frame_error import pose_difference
from rendezvous.alignment.window import FREE_CELL, OCCUPIED_CELL, MapWindow
from rendezvous.baselines.correlative import motion_scores, peak_around
from rendezvous.geometry.se2 import SE2
from rendezvous.models.posterior import Gaussian
from tests.baselines.windows import window_with


def peak(theta: SE2, window: MapWindow, temperature: float = 30.0) -> Gaussian:
    return peak_around(
        theta,
        window,
        blur_m=0.07,
        free_penalty=1.0,
        step_m=0.05,
        step_rad=math.radians(0.5),
        steps_xy=3,
        steps_yaw=4,
        temperature=temperature,
    )


def test_a_map_on_itself_scores_twice_its_walls():
    window = window_with(SE2.identity())
    same = MapWindow(cells=window.cells[[0, 0]], cell_m=window.cell_m)
    walls = int((same.cells[0, 1:-1, 1:-1] == OCCUPIED_CELL).sum())
    scores = motion_scores(np.zeros((1, 3)), same, blur_m=0.07, free_penalty=1.0)
    assert scores == approx([2 * walls])


def test_scores_do_not_depend_on_which_map_is_called_the_first():
    window = window_with(SE2(0.4, -0.3, 0.2))
    swapped = MapWindow(cells=window.cells[::-1].copy(), cell_m=window.cell_m)
    thetas = [SE2(0.4, -0.3, 0.2), SE2(0.1, 0.2, -0.1)]
    forth = np.array([t.as_array() for t in thetas])
    back = np.array([t.inverse().as_array() for t in thetas])
    settings = {"blur_m": 0.07, "free_penalty": 1.0}
    assert motion_scores(forth, window, **settings) == approx(motion_scores(back, swapped, **settings))


def test_the_mean_is_nearer_to_the_truth_than_a_cell_of_the_search():
    theta = SE2(0.42, -0.33, 0.2)
    window = window_with(theta)
    found = peak(theta @ SE2(0.05, -0.05, math.radians(1.0)), window)
    error = pose_difference(found.mean, theta).as_array()
    assert np.abs(error[:2]).max() < 0.015
    assert abs(error[2]) < math.radians(0.25)


def test_a_lone_straight_wall_leaves_the_direction_along_it_uncertain():
    cells = np.full((2, 200, 200), FREE_CELL, np.uint8)
    cells[:, 100, :] = OCCUPIED_CELL
    covariance = peak(SE2.identity(), MapWindow(cells=cells, cell_m=0.05), temperature=10.0).covariance
    assert covariance[0, 0] > 20 * covariance[1, 1]
    assert np.linalg.eigvalsh(covariance).min() > 0.0


def test_a_higher_temperature_widens_the_covariance():
    theta = SE2(0.42, -0.33, 0.2)
    cold, hot = (peak(theta, window_with(theta), temperature=t).covariance for t in (30.0, 300.0))
    assert (np.diag(hot) > np.diag(cold)).all()


def test_it_is_never_surer_than_the_cells_of_its_box():
    theta = SE2(0.42, -0.33, 0.2)
    covariance = peak(theta, window_with(theta), temperature=0.01).covariance
    step = np.array([0.05, 0.05, math.radians(0.5)])
    assert (np.diag(covariance) >= 0.999 * step**2 / 12.0).all()
