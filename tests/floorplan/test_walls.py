import hashlib
import io
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh
from rendezvous.floorplan.furnish import furnish
from rendezvous.floorplan.records import Floorplan, Shape, Solid
from rendezvous.floorplan.validate import validated
from rendezvous.floorplan.walls import (
    floorplan_scene,
    glb,
    lidar_outline,
    sight_obstacles,
    wall_boxes,
    wall_polygon,
)
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


HASH_OF_A_SCENE = """
import hashlib
from rendezvous.floorplan.furnish import furnish
from rendezvous.floorplan.walls import floorplan_scene, glb
from rendezvous.seeds import stream
from tests.floorplan.plans import RADIUS_M, generated
plan = generated(1)
solids = furnish(plan, stream(0, "scene"), density=1.0, robot_radius_m=RADIUS_M)
scene = floorplan_scene(plan, solids, height_m=2.5)
print(hashlib.sha256(glb(scene)).hexdigest())
"""


def check_closed(plan: Floorplan, scene: trimesh.Scene, height_m: float) -> None:
    for name, mesh in scene.geometry.items():
        assert mesh.is_watertight, name
        assert mesh.volume > 0.0, name
    wall_m2 = wall_polygon(plan, thickness_m=0.15).area
    assert scene.geometry["walls"].volume == pytest.approx(wall_m2 * height_m, rel=1e-6)


@pytest.mark.parametrize("index", range(10))
def test_meshes_are_watertight_and_hold_their_volume(index: int):
    plan = generated(index)
    solids = furnish(plan, stream(0, "scene", index), density=1.0, robot_radius_m=RADIUS_M)
    scene = floorplan_scene(plan, solids, height_m=2.5)
    check_closed(plan, scene, 2.5)
    assert len(scene.geometry) == 2 + len({solid.item for solid in solids})


def test_meshes_of_genuine_plans_are_watertight(real_data: Path):
    for read in genuine(real_data):
        plan = validated(read, robot_radius_m=RADIUS_M)
        check_closed(plan, floorplan_scene(plan, (), height_m=2.0), 2.0)


def test_solids_stand_where_they_are_said_to():
    box = Solid(
        shape=Shape.BOX, x_m=1.0, y_m=2.0, yaw_rad=0.5, half_x_m=0.4, half_y_m=0.2, z0_m=0.1, z1_m=0.9,
        category="box", item=0,
    )  # fmt: skip
    pole = Solid(
        shape=Shape.CYLINDER, x_m=6.0, y_m=1.0, yaw_rad=0.0, half_x_m=0.1, half_y_m=0.1, z0_m=0.0, z1_m=1.5,
        category="pole", item=1,
    )  # fmt: skip
    scene = floorplan_scene(plan_of(TWO_ROOMS), (box, pole), height_m=2.0)
    assert set(scene.graph.nodes_geometry) == {"floor", "walls", "000-box", "001-pole"}
    mesh = scene.geometry["000-box"]
    assert mesh.volume == pytest.approx(0.8 * 0.4 * 0.8)
    assert mesh.bounds[:, 2] == pytest.approx([0.1, 0.9])
    footprint = shapely.MultiPoint(mesh.vertices[:, :2]).convex_hull
    assert footprint.symmetric_difference(shapely.Polygon(box.corners_m())).area < 1e-9
    assert scene.geometry["001-pole"].bounds == pytest.approx(
        np.array([[5.9, 0.9, 0.0], [6.1, 1.1, 1.5]]), abs=2e-3
    )
    assert scene.geometry["floor"].bounds[:, 2] == pytest.approx([-0.02, 0.0])


def test_glb_has_y_up():
    scene = floorplan_scene(plan_of(TWO_ROOMS), (), height_m=2.0)
    read = trimesh.load(io.BytesIO(glb(scene)), file_type="glb")
    assert set(read.geometry) == {"floor", "walls"}
    low, high = read.bounds
    # x stays, world z (height) is glTF's y, world y is glTF's -z.
    assert (low[0], high[0]) == pytest.approx((-0.15, 8.15))
    assert (low[1], high[1]) == pytest.approx((-0.02, 2.0))
    assert (low[2], high[2]) == pytest.approx((-4.15, 0.15))
    # The scene given is left as it was.
    assert scene.bounds[:, 2] == pytest.approx([-0.02, 2.0])


def test_glb_has_the_same_bytes_in_every_process():
    plan = generated(1)
    scene = floorplan_scene(
        plan, furnish(plan, stream(0, "scene"), density=1.0, robot_radius_m=RADIUS_M), height_m=2.5
    )
    here = hashlib.sha256(glb(scene)).hexdigest()
    for hash_seed in ("1",):
        there = subprocess.run(
            [sys.executable, "-c", HASH_OF_A_SCENE],
            env={**os.environ, "PYTHONHASHSEED": hash_seed},
            capture_output=True,
            text=True,
            check=True,
            cwd=Path(__file__).parents[2],
        )
        assert there.stdout.strip() == here
