from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import shapely

from rendezvous.floorplan.furnish import furnish
from rendezvous.floorplan.records import Floorplan, Shape, Solid
from rendezvous.floorplan.validate import validated
from rendezvous.floorplan.walls import lidar_outline, sight_obstacles, wall_boxes, wall_polygon
from rendezvous.seeds import stream
from tests.floorplan.plans import RADIUS_M, TWO_ROOMS, generated, genuine, plan_of

HEIGHT_M = 1.0


def union_of_boxes(plan: Floorplan) -> shapely.Geometry:
    boxes = wall_boxes(plan, height_m=HEIGHT_M)
    return shapely.union_all(shapely.polygons([box.corners_m() for box in boxes]))


def uncovered_m(plan: Floorplan) -> float:
    """The longest stretch of wall face without a box behind it."""
    faces = plan.free_space().boundary
    bare = shapely.get_parts(shapely.line_merge(faces.difference(union_of_boxes(plan).buffer(1e-6))))
    return float(shapely.length(bare).max()) if len(bare) else 0.0


def test_wall_of_two_rooms_has_its_area():
    wall = wall_polygon(plan_of(TWO_ROOMS), thickness_m=0.2)
    assert wall.area == pytest.approx(8.4 * 4.4 - 8.0 * 4.0 + 0.1 * (4.0 - 0.9))


def test_a_courtyard_is_wall():
    ring = [
        [0, 0],
        [9, 0],
        [9, 9],
        [4.6, 9],
        [4.6, 6],
        [6, 6],
        [6, 3],
        [3, 3],
        [3, 6],
        [4.5, 6],
        [4.5, 9],
        [0, 9],
    ]
    wall = wall_polygon(plan_of([[float(x), float(y)] for x, y in ring]), thickness_m=0.2)
    assert wall.covers(shapely.Point(4.5, 4.5))


@pytest.mark.parametrize("index", range(12))
def test_boxes_stay_in_the_wall_and_leave_no_gap(index: int):
    plan = generated(index)
    assert union_of_boxes(plan).intersection(plan.free_space()).area < 1e-9
    assert uncovered_m(plan) <= 0.021


def test_boxes_of_genuine_plans_stay_in_the_wall_and_leave_no_gap(real_data: Path):
    for read in genuine(real_data):
        plan = validated(read, robot_radius_m=RADIUS_M)
        assert union_of_boxes(plan).intersection(plan.free_space()).area < 1e-9
        assert uncovered_m(plan) <= 0.021


def test_boxes_of_a_jittered_thin_notch_stay_in_it():
    ring = [
        [0, 0],
        [3.97, 0],
        [3.985, 1.5],
        [4.01, 1.52],
        [4.03, 0],
        [8, 0],
        [8, 4],
        [4.05, 4],
        [4.0, 2.4],
        [3.95, 4],
        [0, 4],
    ]
    plan = plan_of([[float(x), float(y)] for x, y in ring])
    assert union_of_boxes(plan).intersection(plan.free_space()).area < 1e-9
    assert uncovered_m(plan) < 0.07  # the north notch ends in an edge of 4 degrees


def test_every_box_has_a_side_on_its_face():
    plan = generated(3)
    for box, edge in zip(wall_boxes(plan, height_m=HEIGHT_M), plan.edges_m(), strict=True):
        face = shapely.LineString(edge.reshape(2, 2))
        on_face = [p for p in box.corners_m() if face.distance(shapely.Point(p)) < 1e-9]
        assert len(on_face) == 2
        assert (box.z0_m, box.z1_m, box.category, box.item) == (0.0, HEIGHT_M, "wall", -1)


def solid(shape: Shape, z0_m: float, z1_m: float, **where: float) -> Solid:
    size = {"x_m": 1.0, "y_m": 1.0, "yaw_rad": 0.0, "half_x_m": 0.2, "half_y_m": 0.2, **where}
    return Solid(shape=shape, z0_m=z0_m, z1_m=z1_m, category="test", item=0, **size)


def test_a_level_scan_sees_what_is_at_its_height():
    plan = plan_of(TWO_ROOMS)
    solids = [
        solid(Shape.BOX, 0.0, 0.5),
        solid(Shape.BOX, 0.4, 0.8),
        solid(Shape.CYLINDER, 0.0, 0.3),
        solid(Shape.CYLINDER, 0.0, 0.1),
    ]
    segments, circles = lidar_outline(plan, solids, height_m=0.182)
    assert segments.shape == (12 + 4, 4)
    np.testing.assert_allclose(segments[:12], plan.edges_m())
    np.testing.assert_allclose(circles, [[1.0, 1.0, 0.2]])


def test_box_sides_close_around_the_footprint():
    box = solid(Shape.BOX, 0.0, 0.5, yaw_rad=0.3, half_x_m=0.4)
    segments, _ = lidar_outline(plan_of(TWO_ROOMS), [box], height_m=0.2)
    sides = segments[12:]
    np.testing.assert_allclose(sides[:, 2:], np.roll(sides[:, :2], -1, axis=0))
    assert shapely.Polygon(sides[:, :2]).equals_exact(shapely.Polygon(box.corners_m()), 1e-12)


def test_sight_keeps_heights():
    solids = [solid(Shape.BOX, 0.4, 0.8), solid(Shape.CYLINDER, 0.1, 0.3)]
    segments, z0_m, z1_m, circles = sight_obstacles(plan_of(TWO_ROOMS), solids, wall_height_m=2.5)
    assert segments.shape == (16, 4)
    np.testing.assert_allclose(z0_m, [0.0] * 12 + [0.4] * 4)
    np.testing.assert_allclose(z1_m, [2.5] * 12 + [0.8] * 4)
    np.testing.assert_allclose(circles, [[1.0, 1.0, 0.2, 0.1, 0.3]])


def test_no_furniture_gives_empty_arrays_of_the_right_shape():
    segments, z0_m, z1_m, circles = sight_obstacles(plan_of(TWO_ROOMS), (), wall_height_m=2.5)
    assert (segments.shape, z0_m.shape, z1_m.shape, circles.shape) == ((12, 4), (12,), (12,), (0, 5))
    assert lidar_outline(plan_of(TWO_ROOMS), (), height_m=0.1)[1].shape == (0, 3)


def test_a_scan_at_table_height_sees_the_top_instead_of_the_legs():
    plan = generated(0)
    solids = furnish(plan, stream(0, "walls"), density=1.0, robot_radius_m=RADIUS_M)
    tops = [s for s in solids if s.z0_m >= 0.4 and s.z0_m <= 0.73 <= s.z1_m and s.shape is Shape.BOX]
    segments, _ = lidar_outline(plan, tops, height_m=0.73)
    assert tops
    assert len(segments) == len(plan.edges_m()) + 4 * len(tops)
    assert len(lidar_outline(plan, tops, height_m=0.182)[0]) == len(plan.edges_m())


def test_a_scan_sees_what_ends_or_begins_at_its_height():
    solids = [solid(Shape.CYLINDER, 0.0, 0.2, half_x_m=0.1), solid(Shape.CYLINDER, 0.2, 0.5, half_x_m=0.2)]
    for height_m, seen_m in ((0.2, [0.1, 0.2]), (0.19, [0.1]), (0.21, [0.2]), (0.51, [])):
        _, circles = lidar_outline(plan_of(TWO_ROOMS), solids, height_m=height_m)
        assert circles[:, 2].tolist() == seen_m
