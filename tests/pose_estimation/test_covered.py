from __future__ import annotations

import numpy as np
import pytest

from rendezvous.pose_estimation.covered import covered_image


@pytest.mark.parametrize(("left", "side"), [(20, "right"), (60, "left")])
def test_a_robot_and_a_margin_are_covered_by_the_wider_side(left: int, side: str):
    image = np.full((60, 100, 3), 80, np.uint8)
    image[:, :left], image[:, left + 20 :] = 40, 120
    # The robot sticks out of its box by a tenth, all around.
    image[18:42, left - 2 : left + 22] = 200
    box_px = np.array([left, 20.0, left + 20.0, 40.0])
    covered = covered_image(image, box_px)
    assert (covered[16:45, left - 4 : left + 25] == {"left": 40, "right": 120}[side]).all()
    untouched = np.ones((60, 100), bool)
    untouched[16:45, left - 4 : left + 25] = False
    assert np.array_equal(covered[untouched], image[untouched])
    assert (image[20:40, left : left + 20] == 200).all()


@pytest.mark.parametrize("box", [[0, 0, 99, 59], [90, 0, 99, 10], [0, 50, 5, 59], [5, 5, 95, 55]])
def test_a_robot_that_leaves_no_room_beside_it_is_covered_all_the_same(box: list[int]):
    image = np.arange(60 * 100 * 3, dtype=np.uint32).astype(np.uint8).reshape(60, 100, 3)
    assert covered_image(image, np.array(box, float)).shape == image.shape


def test_the_cover_is_the_mirror_image_of_what_lies_beside():
    """A box of 20 with its margin covers 29 columns; each takes the one as far beyond the edge."""
    image = np.zeros((60, 100, 3), np.uint8)
    image[...] = np.arange(100, dtype=np.uint8)[None, :, None]
    from_left = covered_image(image, np.array([60.0, 20.0, 80.0, 40.0]))
    assert from_left[30, 56:85, 0].tolist() == [55 - k for k in range(29)]
    from_right = covered_image(image, np.array([20.0, 20.0, 40.0, 40.0]))
    assert from_right[30, 16:45, 0].tolist() == [73 - k for k in range(29)]
