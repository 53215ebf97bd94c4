from __future__ import annotations

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
from rendezvous.floorplan.scene import floorplan_scene, glb
from rendezvous.floorplan.validate import validated
from rendezvous.floorplan.walls import wall_polygon
from rendezvous.seeds import stream
from tests.floorplan.plans import RADIUS_M, TWO_ROOMS, generated, genuine, plan_of

HASH_OF_A_SCENE = """
import hashlib
from rendezvous.floorplan.furnish import furnish
from rendezvous.floorplan.scene import floorplan_scene, glb
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
