"""The window in which the frame error is looked for."""

import math

import numpy as np
import pytest
from rendezvous.alignment.estimate import Estimate
from rendezvous.alignment.frame_error import corrected, frame_error, initial_alignment, meeting_point
from rendezvous.alignment.sight import ROBOT_CELL
from rendezvous.alignment.window import DEFAULT_SEARCH, MapWindow, SearchRange
from rendezvous.fusion.fusion_input import FusionInput
from rendezvous.fusion.prior import FrameErrorPrior
from rendezvous.fusion.refinement import WINDOW_TURN_RAD, refined
from rendezvous.geometry.se2 import SE2
from rendezvous.models.posterior import Gaussian

from tests.fusion.grids import drawn_grid

T_R0_R1 = SE2(0.7, 0.2, 2.0)


def looked_at(*, yaw_0: float, yaw_1: float) -> tuple[MapWindow, float, FusionInput, SE2]:
    """The window, its yaw in m0, the meeting and T̃; the maps' cells lie at these yaws in m0."""
    T_m0_r0, T_m0_m1 = SE2(0.3, -0.4, 0.5), SE2(1.0, 2.0, 0.7)
    meeting = FusionInput(
        grid_0=drawn_grid(0, T_m_g=SE2(-1.0, 0.5, yaw_0)),
        grid_1=drawn_grid(1, T_m_g=SE2(0.4, 0.2, yaw_1 - T_m0_m1.yaw_rad)),
        T_m0_r0=T_m0_r0,
        T_m1_r1=T_m0_m1.inverse() @ T_m0_r0 @ T_R0_R1,
    )
    T = initial_alignment(T_m0_r0, T_R0_R1, meeting.T_m1_r1)
    # A mean along x of w: where it points in the window tells how the window is turned.
    along_x = Gaussian(mean=SE2(1.0, 0.0, 0.0), covariance=np.eye(3))
    seen: list[MapWindow] = []
    yaws: list[float] = []

    class Answer:
        name = "answer"

        def __call__(self, window: MapWindow) -> Estimate:
            seen.append(window)
            return Estimate(theta=None, reason="only looks")

    def refiner(prior: FrameErrorPrior):
        yaws.append(-math.atan2(prior.outlier.mean.y_m, prior.outlier.mean.x_m))
        return Answer(), DEFAULT_SEARCH

    refined(
        meeting,
        T,
        meeting_point(T, meeting.T_m1_r1),
        refiner,
        FrameErrorPrior(modes=(along_x,), outlier=along_x, degrees_of_freedom=(math.inf,)),
    )
    return seen[0], yaws[0], meeting, T


@pytest.mark.parametrize("yaw_0", [0.0, 0.3])
@pytest.mark.parametrize("between_deg", [0.0, 22.5, -22.5, 45.0, 67.5, 112.5, 200.0])
def test_the_window_lies_along_the_cells_of_neither_map(yaw_0: float, between_deg: float):
    yaw_1 = yaw_0 + math.radians(between_deg)
    _, yaw_rad, _, _ = looked_at(yaw_0=yaw_0, yaw_1=yaw_1)
    for along in (yaw_0, yaw_1):
        # Cells look the same after a quarter turn.
        assert abs(math.remainder(yaw_rad - along, 0.5 * math.pi)) >= WINDOW_TURN_RAD - 1e-9


def test_the_window_shows_each_robot_where_it_stood_in_its_own_map():
    window, yaw_rad, meeting, T = looked_at(yaw_0=0.2, yaw_1=1.0)
    T_m0_v = meeting_point(T, meeting.T_m1_r1) @ SE2(0.0, 0.0, yaw_rad)
    assert window.sight is not None
    for sight, T_m0_r in zip(window.sight, (meeting.T_m0_r0, T @ meeting.T_m1_r1), strict=True):
        T_v_r = T_m0_v.inverse() @ T_m0_r
        row, col = (np.argwhere(sight == ROBOT_CELL) + 0.5).mean(axis=0) - 0.5 * len(sight)
        assert (col * window.cell_m, row * window.cell_m) == pytest.approx((T_v_r.x_m, T_v_r.y_m), abs=0.05)


def test_an_answer_in_the_turned_window_comes_back_along_the_axes_of_map_0():
    theta, spread = SE2(0.3, -0.1, 0.2), np.diag([0.09, 0.01, 0.04])
    _, yaw_rad, given, T = looked_at(yaw_0=0.2, yaw_1=1.0)

    def refiner(prior: FrameErrorPrior | None):
        return lambda window: Estimate(theta=theta, covariance=spread), DEFAULT_SEARCH

    found = refined(given, T, meeting_point(T, given.T_m1_r1), refiner, None)
    R = SE2(0.0, 0.0, yaw_rad)
    assert found.estimate.theta.as_array() == pytest.approx((R @ theta @ R.inverse()).as_array())
    ahead = R.matrix()[:, 0]  # of the window: there the spread is widest
    assert ahead @ found.estimate.covariance @ ahead == pytest.approx(0.09)
    assert not found.at_edge


@pytest.mark.parametrize(
    ("theta", "at_edge"),
    [
        (SE2(0.89, -0.89, 0.48), False),
        (SE2(-0.91, 0.0, 0.0), True),
        (SE2(0.0, 0.91, 0.0), True),
        (SE2(0.0, 0.0, -0.49), True),
    ],
)
def test_an_answer_close_to_the_end_of_its_search_is_at_the_edge(theta: SE2, at_edge: bool):
    _, _, given, T = looked_at(yaw_0=0.0, yaw_1=0.0)
    for search, there in (
        (SearchRange(xy_m=1.0, yaw_rad=0.5), at_edge),
        (SearchRange(xy_m=2.0, yaw_rad=math.pi), False),
    ):
        answer = Estimate(theta=theta), search
        found = refined(
            given, T, meeting_point(T, given.T_m1_r1), lambda _, a=answer: (lambda w: a[0], a[1]), None
        )
        assert found.at_edge == there
        assert found.search == search


def test_what_an_estimate_leaves_lies_along_the_axes_of_map_0_however_far_it_turns():
    T_true, T_m0_v, theta = SE2(2.0, -1.0, 1.0), SE2(5.0, 3.0, 0.0), SE2(0.5, -0.3, 0.7)
    T_initial = T_m0_v @ theta @ T_m0_v.inverse() @ T_true
    T_off = SE2(0.1, 0.0, 0.0) @ T_true  # along x of m0
    theta_hat = frame_error(T_initial, T_off, T_m0_v)
    assert corrected(T_initial, theta_hat, T_m0_v).as_array() == pytest.approx(T_off.wrapped().as_array())
    left = (theta_hat.inverse() @ theta).wrapped()
    assert left.as_array() == pytest.approx([0.1, 0.0, 0.0])
