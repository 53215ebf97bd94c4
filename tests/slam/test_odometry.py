import math

import pytest
from pytest import approx

from rendezvous.slam.slam import WheelOdometry


def test_equal_wheels_go_straight() -> None:
    odometry = WheelOdometry(wheel_radius_m=0.033, track_m=0.16)
    for angle in (0.5, 1.0, 10.5):
        odometry.update((angle, angle))
    assert odometry.pose() == approx([0.33, 0.0, 0.0])


def test_opposite_wheels_turn_on_the_spot() -> None:
    odometry = WheelOdometry(wheel_radius_m=0.033, track_m=0.16)
    odometry.update((0.0, 0.0))
    odometry.update((-1.0, 1.0))
    assert odometry.pose() == approx([0.0, 0.0, 2 * 0.033 / 0.16])


def test_a_circle_closes() -> None:
    odometry = WheelOdometry(wheel_radius_m=0.033, track_m=0.16)
    radius_m, steps = 0.5, 1000
    for k in range(steps + 1):
        angle = 2 * math.pi * k / steps
        odometry.update(((radius_m - 0.08) * angle / 0.033, (radius_m + 0.08) * angle / 0.033))
    assert odometry.pose() == approx([0.0, 0.0, 2 * math.pi], abs=1e-4)


@pytest.mark.parametrize("steps", [1, 3])
def test_a_quarter_arc_in_coarse_steps_ends_ahead_and_aside_by_as_much(steps: int) -> None:
    odometry = WheelOdometry(wheel_radius_m=0.033, track_m=0.16)
    radius_m, step_rad = 0.5, 0.5 * math.pi / steps
    for k in range(steps + 1):
        turned = k * step_rad
        odometry.update(((radius_m - 0.08) * turned / 0.033, (radius_m + 0.08) * turned / 0.033))
    # Each step is as long as its arc, in the direction of its chord.
    end_m = radius_m * 0.5 * step_rad / math.sin(0.5 * step_rad)
    assert odometry.pose() == approx([end_m, end_m, 0.5 * math.pi])
