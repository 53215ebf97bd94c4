"""The picture of a fusion: colours where the maps lie, marks where the robots met."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, f

from rendezvous.evaluation.pictures.canvas import BLUE, RED
from rendezvous.evaluation.pictures.fusion import LONGER_PX, fusion_picture, sighting_picture, view_of_both
from rendezvous.evaluation.pictures.map_panels import BOTH
from rendezvous.fusion.fusion_input import SightedPose
from rendezvous.fusion.system import fuse_maps
from rendezvous.geometry.se2 import SE2
from rendezvous.pose_estimation.pose_estimate import RelativePose
from tests.baselines.windows import cuts
from tests.fusion.test_system import FINE, T_R0_R1, meeting
from tests.synthetic import CAMERA

HEADER_PX = 92


def pixels(image: np.ndarray, colour: tuple[int, int, int]) -> int:
    return int((image[HEADER_PX:] == colour).all(axis=2).sum())


def test_walls_of_both_are_dark_where_the_maps_lie_right():
    right, wrong = (
        fusion_picture(meeting(), fuse_maps(meeting(), SightedPose.given(T_R0_R1 @ error, FINE), None))
        for error in (SE2.identity(), SE2(0.4, 0.3, 0.2))
    )
    assert pixels(right, BOTH) > 3 * pixels(wrong, BOTH)
    assert pixels(right, RED) > 0
    assert pixels(right, BLUE) > 0
    assert max(right.shape[0] - HEADER_PX, right.shape[1]) == LONGER_PX


def test_map_and_robot_1_are_where_the_fusion_puts_them_and_a_cross_where_it_was_seen():
    rough = SightedPose.given(T_R0_R1 @ SE2(0.9, -0.5, 0.4))
    first = fuse_maps(meeting(), rough, None)
    mended = replace(first, T_m0_m1=cuts(0)[2])
    picture = fusion_picture(meeting(), mended)
    assert pixels(picture, BOTH) > 3 * pixels(fusion_picture(meeting(), first), BOTH)
    view, _ = view_of_both(meeting(), mended.T_m0_m1)
    cross_px = marked_px(picture)
    assert cross_px.mean(axis=0) == pytest.approx(view.uv_px(position_m(mended.T_m0_v)), abs=1.0)
    for T_m0_r, colour in ((meeting().T_m0_r0, RED), (mended.T_m0_m1 @ meeting().T_m1_r1, BLUE)):
        u, v = view.uv_px(position_m(T_m0_r)).astype(int)
        assert tuple(picture[HEADER_PX + v, u]) == colour


@pytest.mark.parametrize("tails", [math.inf, 3.6])
def test_the_ellipse_holds_robot_1_with_95_percent_along_the_axes_of_map_0(tails):
    result = fuse_maps(meeting(), SightedPose.given(T_R0_R1), None)
    x_m, y_m, together = 0.4, 0.2, 0.7
    covariance = np.diag([x_m**2, y_m**2, 1e-4])
    covariance[0, 1] = covariance[1, 0] = together * x_m * y_m
    picture = fusion_picture(meeting(), replace(result, covariance=covariance, degrees_of_freedom=tails))
    view, _ = view_of_both(meeting(), result.T_m0_m1)
    off_m = view.p_m(marked_px(picture)) - position_m(result.T_m0_m1 @ meeting().T_m1_r1)
    off_m = off_m[np.hypot(*off_m.T) > 0.25]  # without the cross
    distance = np.einsum("ni,ij,nj->n", off_m, np.linalg.inv(covariance[:2, :2]), off_m)
    if math.isinf(tails):
        inside = chi2.cdf(distance, 2)
        assert np.abs(off_m).max(axis=0) == pytest.approx(np.sqrt(5.991) * np.array([x_m, y_m]), abs=0.04)
    else:
        inside = f.cdf(0.5 * distance * tails / (tails - 2.0), 2, tails)
    assert inside == pytest.approx(0.95, abs=0.03)


def marked_px(picture: np.ndarray) -> np.ndarray:
    """(N, 2) u, v on the panel, of what is drawn in orange."""
    return np.argwhere((picture[HEADER_PX:] == (245, 160, 20)).all(axis=2))[:, ::-1].astype(float)


def position_m(T: SE2) -> np.ndarray:
    return T.as_array()[:2]


def test_an_image_without_the_robot_says_so_below_it():
    image = np.full((480, 640, 3), 90, np.uint8)
    drawn = sighting_picture(image, CAMERA, RelativePose.not_found("too dark"), (0.1, 0.2, 0.2))
    np.testing.assert_array_equal(drawn[:480], image)
    assert (drawn[480:] != 255).any()
