from __future__ import annotations

import numpy as np
from rendezvous.pose_estimation.covered import covered_image


def test_a_covered_robot_shows_what_is_beside_it():
    image = np.zeros((60, 100, 3), np.uint8)
    image[:, :50], image[:, 50:], image[20:30, 40:50] = 80, 80, 200
    covered = covered_image(image, np.array([40.0, 20.0, 50.0, 30.0]))
    assert (covered == 80).all()
    assert (image[20:30, 40:50] == 200).all()
    for box in ([0.0, 0.0, 99.0, 59.0], [90.0, 0.0, 99.0, 10.0], [0.0, 50.0, 5.0, 59.0]):
        assert covered_image(image, np.array(box)).shape == image.shape
