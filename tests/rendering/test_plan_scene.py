from __future__ import annotations

import numpy as np
import pytest
import trimesh

from rendezvous.floorplan.furnish import furnish
from rendezvous.floorplan.records import Shape, Solid
from rendezvous.floorplan.walls import wall_boxes
from rendezvous.geometry.camera import camera_pose, se3_from_se2
from rendezvous.geometry.se2 import SE2
from rendezvous.rendering.appearance.materials import is_second
from rendezvous.rendering.opengl.renderer import Renderer
from rendezvous.rendering.plan_scene import (
    draw_room_looks,
    plan_instances,
    plan_meshes,
    room_instances,
    solid_instance,
)
from rendezvous.rendering.scene import Material, Scene
from rendezvous.rendering.viewpoints import furnished_plan
from rendezvous.seeds import stream
from tests.floorplan.plans import RADIUS_M, TWO_ROOMS, generated, plan_of
from tests.rendering.scenes import CAMERA, GREY, WHITE, facing_x, looking_down, scene_of, sun

HEIGHT_M = 2.5


def material_of(category: str, part: int) -> Material:
    return WHITE if category == "wall" else GREY


@pytest.mark.parametrize("shape", list(Shape))
def test_a_stretched_mesh_has_the_solids_bounds_and_faces_outwards(shape: Shape):
    half_y_m = 0.3 if shape is Shape.CYLINDER else 0.2
    solid = Solid(
        shape=shape, x_m=1.0, y_m=-2.0, yaw_rad=0.5, half_x_m=0.3, half_y_m=half_y_m, z0_m=0.4, z1_m=0.7,
        category="table", item=0,
    )  # fmt: skip
    instance = solid_instance(solid, name="table", material=GREY)
    mesh = plan_meshes()[instance.mesh][0].copy().apply_transform(instance.T_w)
    volume_m3 = (np.pi * 0.3**2 if shape is Shape.CYLINDER else 0.6 * 0.4) * 0.3
    assert mesh.volume == pytest.approx(volume_m3, rel=0.02)
    assert mesh.bounds[:, 2] == pytest.approx([0.4, 0.7])
    corners_m = solid.corners_m() if shape is Shape.BOX else np.array([[0.7, -2.3], [1.3, -1.7]])
    np.testing.assert_allclose(mesh.bounds[:, :2], [corners_m.min(axis=0), corners_m.max(axis=0)], atol=0.01)


@pytest.mark.parametrize("mesh", plan_meshes().values(), ids=plan_meshes())
def test_vertex_normals_are_those_of_the_faces_they_belong_to(mesh: tuple[trimesh.Trimesh, ...]):
    (part,) = mesh
    across = part.vertex_normals[part.faces] @ part.face_normals[:, :, None]
    assert across.min() > 0.99


def test_a_furnished_plan_has_each_wall_and_each_solid_once():
    plan = generated(3)
    furniture = furnish(plan, stream(0, "rendering"), density=1.0, robot_radius_m=RADIUS_M)
    instances = plan_instances(plan, furniture, wall_height_m=HEIGHT_M, material_of=material_of)
    assert len({instance.name for instance in instances}) == len(instances)
    assert len(instances) == 2 + len(wall_boxes(plan, height_m=HEIGHT_M)) + len(furniture)
    walls = [instance for instance in instances if instance.name.startswith("wall/")]
    assert {wall.material for wall in walls} == {WHITE}


def test_one_wall_in_seven_differs_and_furniture_wears_its_own_materials():
    plan = generated(3)
    place = furnished_plan(
        plan, furnish(plan, stream(0, "looks"), density=1.0, robot_radius_m=RADIUS_M), wall_height_m=HEIGHT_M
    )
    looks = draw_room_looks(np.random.default_rng(0), place, variants=2)
    instances = {instance.name: instance for instance in room_instances(place, looks)}
    walls = [instance.material for name, instance in instances.items() if name.startswith("wall/")]
    accents = [i for i, material in enumerate(walls) if material == looks.accent]
    assert accents == list(looks.accent_faces)
    assert 0.02 < len(accents) / len(walls) < 0.35
    assert {walls[i] for i in range(len(walls)) if i not in accents} == {looks.wall}
    assert (instances["floor"].material, instances["ceiling"].material) == (looks.floor, looks.ceiling)
    for i, solid in enumerate(place.furniture):
        material = instances[f"{solid.item:03d}-{solid.category}/{i:04d}"].material
        assert material == looks.pieces[solid.item][is_second(solid)]


def room(**fields: object) -> Scene:
    plan = plan_of(TWO_ROOMS)
    instances = plan_instances(plan, (), wall_height_m=HEIGHT_M, material_of=material_of)
    return scene_of(*instances, **fields)


def test_from_inside_a_room_nothing_but_floor_walls_and_ceiling_is_seen(renderer: Renderer):
    for yaw_rad in np.linspace(0.0, 2.0 * np.pi, 9):
        T_w_c = facing_x(height_m=0.9)
        turn = trimesh.transformations.rotation_matrix(yaw_rad, [0.0, 0.0, 1.0])
        T_w_c = trimesh.transformations.translation_matrix([1.3, 1.7, 0.0]) @ turn @ T_w_c
        scene = room(T_w_c=T_w_c)
        ids = renderer.render(scene).instance_ids
        assert (ids >= 0).all()


def test_a_wall_shows_by_its_own_face_only(renderer: Renderer):
    """Where walls share a plane, pixels of one must not show another."""
    plan = generated(3)
    instances = plan_instances(plan, (), wall_height_m=HEIGHT_M, material_of=material_of)
    start_m = np.array(plan.free_space().representative_point().coords[0])
    seen = 0
    for yaw_rad in np.linspace(0.0, 2.0 * np.pi, 7):
        T_w_c = se3_from_se2(SE2(*start_m, yaw_rad)) @ camera_pose(np.array([0.0, 0.0, 0.3]), np.zeros(3))
        scene = scene_of(*instances, T_w_c=T_w_c)
        rendering = renderer.render(scene)
        v, u = np.indices(rendering.depth_m.shape)
        rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(CAMERA.K()).T
        p_w = rendering.depth_m[..., None] * rays @ T_w_c[:3, :3].T + T_w_c[:3, 3]
        for i in np.unique(rendering.instance_ids):
            if i >= 0 and instances[i].name.startswith("wall"):
                p_box = np.linalg.inv(instances[i].T_w) @ _homogeneous(p_w[rendering.instance_ids == i]).T
                depth_m = np.linalg.norm(instances[i].T_w[:3, 1]) * (0.5 - p_box[1])
                assert np.quantile(np.abs(depth_m), 0.99) < 0.01
                seen += p_box.shape[1]
    assert seen > 20_000


def _homogeneous(points: np.ndarray) -> np.ndarray:
    return np.concatenate([points, np.ones((len(points), 1))], axis=1)


def test_the_ceiling_shows_from_below_only_and_lets_light_in(renderer: Renderer):
    from_above = looking_down(height_m=3.5)
    from_above[:2, 3] = 2.0, 2.0
    scene = room(T_w_c=from_above)
    seen = {scene.instances[i].name for i in np.unique(renderer.render(scene).instance_ids)}
    assert "floor" in seen
    assert "ceiling" not in seen
    inside = from_above.copy()
    inside[2, 3] = 1.0
    shadowed, plain = (
        renderer.render(room(T_w_c=inside, lights=(sun(casts_shadow=casts_shadow),))).rgb
        for casts_shadow in (True, False)
    )
    assert np.abs(shadowed.astype(int) - plain).max() <= 1
