import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from rendezvous.exploration.rendezvous import Sighting, cuboid_samples, sight
from rendezvous.floorplan.walls import SightObstacles
from rendezvous.geometry.se2 import SE2, Array
from tests.simulation.scenes import burger


def obstacles(
    segments: list[list[float]] | None = None, *, bottom_m: float = 0.0, top_m: float = 2.5,
    circles: list[list[float]] | None = None,
) -> SightObstacles:  # fmt: skip
    segments_m = np.array(segments or [], float).reshape(-1, 4)
    return SightObstacles(
        segments_m=segments_m,
        bottoms_m=np.full(len(segments_m), bottom_m),
        tops_m=np.full(len(segments_m), top_m),
        circles_m=np.array(circles or [], float).reshape(-1, 5),
    )


def view(T_w_r1: SE2, around: SightObstacles | None = None, T_w_r0: SE2 | None = None) -> Sighting | None:
    return sight(
        burger(),
        burger(),
        T_w_r0 or SE2.identity(),
        T_w_r1,
        around or obstacles(),
        min_range_m=0.4,
        max_range_m=4.0,
    )


def test_samples_lie_on_the_surface_of_the_cuboid() -> None:
    cuboid = burger().cuboid
    offsets: Array = np.abs(cuboid_samples(cuboid) - np.array(cuboid.centre_m)) / np.array(cuboid.size_m)
    assert offsets.shape == (26, 3)
    assert offsets.max(axis=1) == approx(np.full(26, 0.5))


def test_a_robot_in_the_open_is_seen_whole_at_its_range_and_bearing() -> None:
    seen = view(SE2(2.0, 0.3, 1.0))
    assert seen is not None
    assert seen.visible_fraction == 1.0
    centre = SE2(2.0, 0.3, 1.0) @ np.array([-0.032, 0.0])
    assert seen.bearing_rad == approx(math.atan2(centre[1], centre[0]))
    assert seen.range_m == approx(math.dist((0.034, 0.0, 0.12), (*centre, 0.096)))


def test_only_relative_poses_matter() -> None:
    T_w_r0 = SE2(3.0, -2.0, 2.1)
    relative, moved = view(SE2(1.5, -0.4, 2.0)), view(T_w_r0 @ SE2(1.5, -0.4, 2.0), T_w_r0=T_w_r0)
    assert relative is not None
    assert moved is not None
    assert moved.visible_fraction == relative.visible_fraction
    assert moved.range_m == approx(relative.range_m)


@pytest.mark.parametrize("xy_m", [(-2.0, 0.0), (0.3, 2.0), (4.3, 0.0), (0.3, 0.0)])
def test_behind_beside_too_far_and_too_near_are_not_seen(xy_m: tuple[float, float]) -> None:
    assert view(SE2(*xy_m, 0.0)) is None


def test_the_edge_of_the_image_cuts_the_robot() -> None:
    # Half of the 55 degrees: the robot's middle stands on the image's edge.
    bearing = math.atan(320 / 616)
    at = np.array([0.034, 0.0]) + 2.0 * np.array([math.cos(bearing), math.sin(bearing)])
    seen = view(SE2(at[0] + 0.032, at[1], 0.0))
    assert seen is not None
    assert 0.3 < seen.visible_fraction < 0.7


def test_a_wall_hides_and_half_a_wall_hides_half() -> None:
    pose = SE2(2.0, 0.0, 0.0)
    hidden = view(pose, obstacles([[1.0, -2.0, 1.0, 2.0]]))
    assert hidden is not None
    assert hidden.visible_fraction == 0.0
    half = view(pose, obstacles([[1.0, 0.001, 1.0, 2.0]]))
    assert half is not None
    assert half.visible_fraction == approx(17 / 26)  # the middle row of samples lies just in the open


def test_a_table_top_above_the_line_of_sight_hides_nothing_and_a_low_box_hides_the_lower_part() -> None:
    pose = SE2(2.0, 0.0, 0.0)
    top = view(pose, obstacles([[1.0, -2.0, 1.0, 2.0]], bottom_m=0.70, top_m=0.75))
    assert top is not None
    assert top.visible_fraction == 1.0
    # At half way the line of sight to the top edge passes at 0.156 m, to the middle at 0.108 m.
    low = view(pose, obstacles([[1.0, -2.0, 1.0, 2.0]], top_m=0.13))
    assert low is not None
    assert low.visible_fraction == approx(9 / 26)


def test_a_pole_hides_what_is_behind_it() -> None:
    pose = SE2(2.0, 0.0, 0.0)
    seen = view(pose, obstacles(circles=[[1.0, 0.0, 0.02, 0.0, 1.0]]))
    assert seen is not None
    assert seen.visible_fraction == approx(18 / 26)


@pytest.mark.parametrize(
    "circle",
    [
        [1.0, 0.5, 0.02, 0.0, 1.0],  # beside the line of sight
        [1.0, 0.0, 0.4, 0.72, 0.75],  # a round table top above it
        [1.0, 0.0, 0.02, 0.0, 0.04],  # below it
    ],
)
def test_a_cylinder_off_the_line_of_sight_hides_nothing(circle: list[float]) -> None:
    seen = view(SE2(2.0, 0.0, 0.0), obstacles(circles=[circle]))
    assert seen is not None
    assert seen.visible_fraction == 1.0


def test_a_camera_turned_to_the_side_sees_what_stands_there() -> None:
    turned = replace(burger(), camera=replace(burger().camera, rpy_rad=(0.0, 0.0, 1.2)))
    ahead = SE2(2.0 * math.cos(1.4), 2.0 * math.sin(1.4), 0.0)
    seen = sight(turned, burger(), SE2.identity(), ahead, obstacles(), min_range_m=0.4, max_range_m=4.0)
    assert seen is not None
    assert seen.visible_fraction == 1.0
    assert view(ahead) is None


def test_the_bounds_of_the_range_belong_to_it() -> None:
    seen = view(SE2(2.0, 0.3, 1.0))
    assert seen is not None
    for low_m, high_m, is_seen in (
        (seen.range_m, 4.0, True), (0.4, seen.range_m, True),
        (seen.range_m + 1e-9, 4.0, False), (0.4, seen.range_m - 1e-9, False),
    ):  # fmt: skip
        again = sight(
            burger(), burger(), SE2.identity(), SE2(2.0, 0.3, 1.0), obstacles(),
            min_range_m=low_m, max_range_m=high_m,
        )  # fmt: skip
        assert (again is not None) == is_seen


def test_a_disc_at_the_cameras_own_height_hides_only_what_is_behind_it() -> None:
    # At half way the lines of sight to the three rows of samples pass at 0.06, 0.108 and 0.156 m.
    seen = view(SE2(2.0, 0.0, 0.0), obstacles(circles=[[1.0, 0.0, 0.02, 0.112, 0.130]]))
    assert seen is not None
    assert seen.visible_fraction == 1.0


def test_a_camera_that_looks_down_sees_farther_to_the_side() -> None:
    high = replace(
        burger(), camera=replace(burger().camera, xyz_m=(0.034, 0.0, 1.5), rpy_rad=(0.0, 1.0, 0.0))
    )
    beside = SE2(0.8 * math.cos(1.0), 0.8 * math.sin(1.0), 0.0)
    seen = sight(high, burger(), SE2.identity(), beside, obstacles(), min_range_m=0.4, max_range_m=4.0)
    assert seen is not None
    assert seen.visible_fraction > 0.5
