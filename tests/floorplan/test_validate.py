from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from rendezvous.errors import ConfigError, FloorplanError
from rendezvous.floorplan.records import Floorplan
from rendezvous.floorplan.validate import FloorplanLimits, reachable_space, start_regions, validated
from tests.floorplan.plans import RADIUS_M, TWO_ROOMS, generated, genuine, plan_of

AREA_M2 = 8.0 * 4.0 - 0.1 * (4.0 - 0.9)


def doorway(width_m: float) -> Floorplan:
    """Two rooms of 3.95 m x 4 m with an opening of this width."""
    low, high = 2.0 - 0.5 * width_m, 2.0 + 0.5 * width_m
    ring = [[x, {1.5: low, 2.4: high}.get(y, y)] for x, y in TWO_ROOMS]
    return plan_of(ring)


def test_a_sound_plan_keeps_its_geometry():
    plan = validated(plan_of(TWO_ROOMS), robot_radius_m=RADIUS_M)
    assert plan.free_space().equals(shapely.Polygon(TWO_ROOMS))


@pytest.mark.parametrize("index", range(12))
def test_validating_twice_is_validating_once(index: int):
    plan = generated(index)
    assert validated(plan, robot_radius_m=RADIUS_M).digest() == plan.digest()


@settings(max_examples=50, deadline=None)
@given(first=st.integers(0, 11), clockwise=st.booleans())
def test_where_a_ring_starts_and_which_way_it_runs_do_not_matter(first: int, clockwise: bool):
    ring = TWO_ROOMS[first:] + TWO_ROOMS[:first]
    plan = validated(plan_of(ring[::-1] if clockwise else ring), robot_radius_m=RADIUS_M)
    assert plan.digest() == validated(plan_of(TWO_ROOMS), robot_radius_m=RADIUS_M).digest()


def test_outline_runs_counter_clockwise_and_holes_clockwise():
    pillar = [[1.0, 1.0], [1.4, 1.0], [1.4, 1.4], [1.0, 1.4]]
    plan = validated(plan_of(TWO_ROOMS[::-1], holes=(pillar,)), robot_radius_m=RADIUS_M)
    assert shapely.LinearRing(plan.outline_m).is_ccw
    assert not shapely.LinearRing(plan.holes_m[0]).is_ccw
    assert plan.free_space().area == pytest.approx(AREA_M2 - 0.16)


def test_duplicate_and_collinear_vertices_fall_away():
    ring = [[0.0, 0.0], [0.0, 0.0], [1.0, 0.0], [2.0, 0.004], *TWO_ROOMS[1:]]
    assert len(validated(plan_of(ring), robot_radius_m=RADIUS_M).outline_m) == 12


def test_a_plan_may_lie_kilometres_from_the_origin():
    plan = validated(plan_of([[x + 9_900.0, y - 9_900.0] for x, y in TWO_ROOMS]), robot_radius_m=RADIUS_M)
    assert plan.free_space().area == pytest.approx(AREA_M2)


def test_a_small_crossing_is_repaired():
    # Two vertices 4 cm apart in the south-east corner have changed places.
    ring = [*TWO_ROOMS[:5], [8.0, 0.03], [7.97, 0.0], *TWO_ROOMS[6:]]
    assert not shapely.Polygon(ring).is_valid
    plan = validated(plan_of(ring), robot_radius_m=RADIUS_M)
    assert plan.free_space().is_valid
    assert plan.free_space().area == pytest.approx(AREA_M2, abs=0.2)


def test_a_wall_of_no_thickness_becomes_none():
    ring = [[0, 0], [2, 0], [2, 1.5], [2, 0], *TWO_ROOMS[1:]]
    plan = validated(plan_of(ring), robot_radius_m=RADIUS_M)
    assert plan.free_space().symmetric_difference(shapely.Polygon(TWO_ROOMS)).area < 1e-3


def test_walls_that_touch_in_a_point_are_joined():
    # A pillar whose corner touches the south wall.
    pillar = [[2.0, 0.0], [2.2, 0.2], [2.0, 0.4], [1.8, 0.2]]
    plan = validated(plan_of(TWO_ROOMS, holes=(pillar,)), robot_radius_m=RADIUS_M)
    assert plan.holes_m == ()
    assert plan.free_space().is_valid
    assert plan.free_space().area == pytest.approx(AREA_M2 - 0.08, abs=0.005)


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        (
            plan_of([[0, 0], [8, 4], [8, 0], [0, 4]]),
            r"^p: the outline crosses itself at \(4\.00, 2\.00\) m, 8\.00 m2 around \(\S+, \S+\) m would be "
            r"lost; an outline must be a simple polygon, faults under 0\.05 m are repaired$",
        ),
        (
            plan_of([[0, 0], [4, 0], [4, 2], [8, 2], [8, 4], [4, 4], [4, 2], [0, 2]]),
            r"^p: the outline touches itself at \(4\.00, 2\.00\) m",
        ),
        (
            plan_of([[x * 100, y * 100] for x, y in TWO_ROOMS]),
            r"^p: 800 m x 400 m from \(0\.00, 0\.00\) m; the sides must be 3 to 60 m, coordinates in metres; "
            r"pixels or millimetres\?$",
        ),
        (
            plan_of([[x + 1e6, y] for x, y in TWO_ROOMS]),
            r"^p: lies at \(1e\+06, 0\) m; must lie within 10000 m of the origin: take a corner of the plan",
        ),
        (plan_of([[x, y - 1e12] for x, y in TWO_ROOMS]), r"^p: lies at \(0, -1e\+12\) m; must lie within"),
        (plan_of([[x / 10, y / 10] for x, y in TWO_ROOMS]), r"^p: 0\.8 m x 0\.4 m .* must be 3 to 60 m"),
        (plan_of([[0, 0], [10, 0], [10, 1], [1, 1], [1, 4], [0, 4]]), r"^p: 13\.0 m2 .* 15 to 1500 m2$"),
        (
            doorway(0.25),
            r"^p: a robot of radius 0\.135 m reaches 50 % of the free space, not the part around "
            r"\(\S+, 2\.00\) m; must reach 80 %$",
        ),
        (
            plan_of([[0, 0], [6, 0], [6, 5], [0, 5]]),
            r"^p: 1 room\(s\) to start in, around \(3\.00, 2\.50\) m; two robots need at least 2 rooms with "
            r"a doorway under 1\.8 m between them$",
        ),
        (doorway(2.4), r"^p: 1 room\(s\) to start in"),
    ],
)  # fmt: skip
def test_unusable_plans_are_told_with_reason_and_place(plan: Floorplan, message: str):
    with pytest.raises(FloorplanError, match=message) as error:
        validated(plan, robot_radius_m=RADIUS_M)
    assert len(str(error.value).splitlines()) == 1


def test_limits_can_be_set():
    with pytest.raises(FloorplanError, match="must be 3 to 7 m"):
        validated(plan_of(TWO_ROOMS), limits=FloorplanLimits(max_side_m=7.0), robot_radius_m=RADIUS_M)
    with pytest.raises(ConfigError, match=r"FloorplanLimits: min_side_m is 5.0; must be from 0.001 to 4"):
        FloorplanLimits(min_side_m=5.0, max_side_m=4.0)


def test_reachable_space_keeps_the_radius():
    reachable = reachable_space(validated(plan_of(TWO_ROOMS), robot_radius_m=RADIUS_M), robot_radius_m=0.2)
    assert shapely.Polygon(TWO_ROOMS).boundary.distance(reachable) == pytest.approx(0.2, abs=0.01)
    # Two rooms of 3.55 m x 3.6 m, and the doorway between them.
    assert reachable.area == pytest.approx(2 * 3.55 * 3.6 + 0.5 * 0.5, abs=0.05)


@pytest.mark.parametrize("width_m", [0.7, 0.9, 1.1, 1.5])
def test_rooms_on_both_sides_of_a_doorway_are_start_regions(width_m: float):
    regions = start_regions(validated(doorway(width_m), robot_radius_m=RADIUS_M), robot_radius_m=RADIUS_M)
    assert len(regions) == 2
    assert sorted(bool(r.centroid.x < 4.0) for r in regions) == [False, True]


def test_a_wider_robot_starts_farther_from_the_walls_and_needs_wider_doors():
    plan = validated(plan_of(TWO_ROOMS), robot_radius_m=0.25)
    regions = start_regions(plan, robot_radius_m=0.25)
    assert [region.distance(plan.free_space().boundary) for region in regions] == pytest.approx(
        [0.25 + 0.145] * 2, abs=0.04
    )
    with pytest.raises(FloorplanError, match=r"a robot of radius 0\.480 m reaches 50 % of the free space"):
        validated(plan, robot_radius_m=0.45)


@pytest.mark.parametrize("index", range(12))
def test_start_regions_are_disjoint_reachable_and_clear_of_walls(index: int):
    plan = generated(index)
    regions = start_regions(plan, robot_radius_m=RADIUS_M)
    walls = plan.free_space().boundary
    reachable = reachable_space(plan, robot_radius_m=0.135)
    assert len(regions) >= 2
    for i, region in enumerate(regions):
        assert region.distance(walls) > 0.21
        assert reachable.covers(region)
        assert all(region.intersection(other).area < 1e-9 for other in regions[:i])


def test_genuine_plans_pass(real_data: Path):
    for read in genuine(real_data):
        plan = validated(read, robot_radius_m=RADIUS_M)
        assert len(start_regions(plan, robot_radius_m=RADIUS_M)) >= 4
        # Nothing moves by more than the pixels that the outline was traced on.
        moved = shapely.hausdorff_distance(
            shapely.LinearRing(read.outline_m), shapely.LinearRing(plan.outline_m), densify=0.05
        )
        assert moved < 0.02
        assert validated(plan, robot_radius_m=RADIUS_M).digest() == plan.digest()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 11), st.integers(0, 2**32 - 1), st.floats(0.0, 0.02))
def test_jittered_corners_do_not_matter(index: int, seed: int, jitter_m: float):
    plan = generated(index)
    noise = np.random.default_rng(seed).uniform(-jitter_m, jitter_m, size=plan.outline_m.shape)
    jittered = Floorplan(plan_id="p", outline_m=plan.outline_m + noise, holes_m=plan.holes_m)
    repaired = validated(jittered, robot_radius_m=RADIUS_M)
    assert repaired.free_space().is_valid
    assert repaired.free_space().area == pytest.approx(plan.free_space().area, rel=0.02)


def test_limits_belong_to_what_they_allow():
    plan = plan_of(TWO_ROOMS)  # 8 m x 4 m
    for limits in (
        FloorplanLimits(min_side_m=4.0, max_side_m=8.0),
        FloorplanLimits(min_area_m2=plan.free_space().area),
        FloorplanLimits(max_area_m2=plan.free_space().area),
        FloorplanLimits(min_start_regions=2),
    ):
        assert validated(plan, limits=limits, robot_radius_m=RADIUS_M).plan_id == plan.plan_id
    for message, limits in (
        ("the sides must be", FloorplanLimits(min_side_m=4.001)),
        ("the sides must be", FloorplanLimits(max_side_m=7.999)),
        (r"2 room\(s\) to start in", FloorplanLimits(min_start_regions=3)),
    ):
        with pytest.raises(FloorplanError, match=message):
            validated(plan, limits=limits, robot_radius_m=RADIUS_M)
