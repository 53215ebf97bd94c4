"""The picture of a fusion: colours where the maps lie, marks where the robots met."""

import numpy as np

from pipeline.evaluation.canvas import BLUE, RED
from pipeline.evaluation.fusion_figures import LONGER_PX, fusion_picture, sighting_picture
from pipeline.evaluation.map_panels import BOTH
from pipeline.fusion.sighted_pose import SightedPose
from pipeline.fusion.system import fuse_maps
from pipeline.geometry.se2 import SE2
from pipeline.pose_estimation.relative_pose import RelativePose
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


def test_an_image_without_the_robot_says_so_below_it():
    image = np.full((480, 640, 3), 90, np.uint8)
    drawn = sighting_picture(image, CAMERA, RelativePose.not_found("too dark"), (0.1, 0.2, 0.2))
    np.testing.assert_array_equal(drawn[:480], image)
    assert (drawn[480:] != 255).any()
