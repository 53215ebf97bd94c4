from __future__ import annotations

import runpy
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from trimesh.visual.material import PBRMaterial

from rendezvous.errors import ConfigError
from rendezvous.rendering.robot_model import (
    check_inside_cuboid,
    creased_mesh,
    part_material,
    robot_glb,
    robot_parts,
)
from rendezvous.rendering.scene import Material
from rendezvous.robot_file import ROBOTS, load_robot
from rendezvous.simulation.robot import Cuboid

BURGER = ROBOTS / "burger"
BLUE = Material(base_colour_rgb=(0.1, 0.2, 0.7), metallic=0.25, roughness=0.4)
RED = Material(base_colour_rgb=(0.8, 0.1, 0.1), roughness=0.9)


@pytest.fixture(scope="module")
def burger() -> dict[str, trimesh.Trimesh]:
    return robot_parts((BURGER / "robot.glb").read_bytes(), source="burger")


@pytest.fixture(scope="module")
def build():
    return runpy.run_path(str(BURGER / "build.py"))


@pytest.fixture(scope="module")
def burger_glb(build):
    return build["burger_glb"]


def _vertices(parts: dict[str, trimesh.Trimesh]) -> np.ndarray:
    return np.concatenate([part.vertices for part in parts.values()])


def test_the_committed_model_is_what_the_script_builds(burger_glb):
    assert burger_glb(load_robot("burger")) == (BURGER / "robot.glb").read_bytes()


def test_the_committed_mjcf_is_what_the_simulation_drives(build):
    mjcf = (BURGER / "robot.xml").read_text()
    assert build["burger_mjcf"](load_robot("burger")) == mjcf
    model = mujoco.MjModel.from_xml_string(mjcf)
    assert model.nu == 2
    assert mujoco.mj_getTotalmass(model) == pytest.approx(load_robot("burger").mass_kg)


def test_the_model_is_small_and_detailed(burger):
    assert (BURGER / "robot.glb").stat().st_size < 1_000_000
    assert 5_000 <= sum(len(part.faces) for part in burger.values()) <= 20_000


def test_the_model_fills_the_cuboid_and_stays_inside(burger):
    cuboid = load_robot("burger").cuboid
    check_inside_cuboid(burger, cuboid, robot="burger")
    vertices = _vertices(burger)
    half_m = 0.5 * np.array(cuboid.size_m)
    # Within a millimetre, as the maker's drawings and the sizes that he states are.
    assert vertices.min(axis=0) == pytest.approx(np.array(cuboid.centre_m) - half_m, abs=1.1e-3)
    assert vertices.max(axis=0) == pytest.approx(np.array(cuboid.centre_m) + half_m, abs=1.1e-3)


def test_wheels_have_the_place_and_size_that_physics_uses(burger):
    wheels = load_robot("burger").wheels
    tyres = burger["tyre"].vertices
    for side in (1.0, -1.0):
        tyre = tyres[side * tyres[:, 1] > 0.0]
        assert tyre[:, 1].mean() == pytest.approx(side * 0.5 * wheels.track_m, abs=1e-6)
        assert np.ptp(tyre[:, 1]) == pytest.approx(wheels.width_m, abs=1e-5)
        from_axle_m = np.hypot(tyre[:, 0], tyre[:, 2] - wheels.radius_m)
        assert from_axle_m.max() == pytest.approx(wheels.radius_m, abs=1e-5)
        assert tyre[:, 2].min() == pytest.approx(0.0, abs=1e-5)


def test_the_camera_has_one_dark_face_about_its_colour_lens(burger):
    """The colour lens is the leftmost of four in a face of 90 mm: the robot file has it in the middle."""
    x_m, y_m, z_m = load_robot("burger").camera.xyz_m
    (x0_m, y0_m, z0_m), (x1_m, y1_m, z1_m) = burger["camera.d435.face"].bounds
    assert x0_m <= x_m + 1e-6 <= x1_m
    assert y0_m < y_m < y1_m
    assert 0.5 * (z0_m + z1_m) == pytest.approx(z_m, abs=1e-5)
    assert 0.5 * (y0_m + y1_m) == pytest.approx(y_m - 0.0325, abs=1e-5)


def test_the_head_turns_at_the_lidars_height(burger):
    lidar = load_robot("burger").lidar
    for model in ("lds01", "lds02"):
        head = burger[f"lidar.{model}.head"].bounds
        assert head[0, 2] < lidar.z_m < head[1, 2]
        assert head.mean(axis=0)[:2] == pytest.approx([lidar.x_m, 0.0], abs=2e-3)
        assert np.abs(head[:, 0] - lidar.x_m).max() <= lidar.cap_radius_m


def test_the_lidars_motor_is_at_the_front_and_the_caster_at_the_back(burger):
    for model in ("lds01", "lds02"):
        deck = burger[f"lidar.{model}.deck"].bounds[:, 0] - load_robot("burger").lidar.x_m
        assert deck[1] > 0.05 > 0.04 > -deck[0]
    assert burger["caster.ball"].bounds[1, 0] < -0.07
    # The Raspberry Pi lies across at the back with its plugs to the right.
    pi, plug = burger["board.pi"].bounds, burger["plug.usb"].bounds
    assert np.ptp(pi, axis=0)[1] > np.ptp(pi, axis=0)[0]
    assert pi.mean(axis=0)[0] < -0.05
    assert plug[1, 1] < 0.0


def test_plates_and_posts_are_where_the_maker_has_them(burger):
    undersides_mm = [1e3 * burger[f"plate.{i}"].bounds[0, 2] for i in range(4)]
    assert undersides_mm == pytest.approx([10.0, 47.5, 95.0, 142.5], abs=0.01)
    assert all(np.ptp(burger[f"plate.{i}"].bounds[:, 2]) == pytest.approx(0.009, abs=1e-5) for i in range(4))
    posts_m = {name: part.bounds.mean(axis=0) for name, part in burger.items() if name.startswith("post")}
    assert posts_m["post.1.front_left"][:2] == pytest.approx([0.032, 0.012], abs=1e-4)
    assert posts_m["post.2.side_right"][:2] == pytest.approx([-0.008, -0.064], abs=1e-4)
    assert len(posts_m) == 14


def test_the_model_follows_the_robot_file(burger, burger_glb, tmp_path):
    text = (BURGER / "robot.yaml").read_text()
    assert "xyz_m: [0.034, 0.0, 0.120]" in text
    (tmp_path / "robot.yaml").write_text(
        text.replace("xyz_m: [0.034, 0.0, 0.120]", "xyz_m: [0.034, 0.01, 0.122]")
    )
    moved = robot_parts(burger_glb(load_robot(str(tmp_path / "robot.yaml"))), source="moved")
    shift_m = moved["camera.d435.face"].bounds - burger["camera.d435.face"].bounds
    assert shift_m == pytest.approx(np.array([[0.0, 0.01, 0.002]] * 2), abs=1e-5)
    assert moved["tyre"].bounds == pytest.approx(burger["tyre"].bounds)


def _view(parts: dict[str, trimesh.Trimesh], axis: int, sign: float, seed: int) -> np.ndarray:
    """(48, 48) the nearest part in each cell of 4 mm along a direction, -1 for none."""
    seen = np.full((48, 48), -1)
    samples = [trimesh.sample.sample_surface(p, 6000, seed=seed + i)[0] for i, p in enumerate(parts.values())]
    points, owner = np.concatenate(samples), np.repeat(np.arange(len(parts)), 6000)
    farthest_first = np.argsort(sign * points[:, axis])
    col, row = np.floor((points[farthest_first][:, [1 - axis, 2]] - [-0.1, 0.0]) / 0.00417).astype(int).T % 48
    seen[row, col] = owner[farthest_first]
    return seen


def _difference(a: np.ndarray, b: np.ndarray) -> float:
    return float((a != b)[(a >= 0) | (b >= 0)].mean())


@pytest.mark.parametrize("axis", [0, 1])
def test_front_and_back_and_both_sides_look_different(burger, axis):
    ahead, again, behind = (
        _view(burger, axis, 1.0, 0),
        _view(burger, axis, 1.0, 100),
        _view(burger, axis, -1.0, 0),
    )
    noise = _difference(ahead, again)
    assert _difference(ahead, behind) > 3.0 * noise
    assert _difference(ahead, behind[:, ::-1]) > 3.0 * noise


def test_every_part_has_a_believable_material(burger):
    materials = {name: part_material(part) for name, part in burger.items()}
    assert len(set(materials.values())) > 15
    assert all(0.0 < m.roughness <= 1.0 for m in materials.values())
    assert materials["camera.d435.body"].metallic > 0.5 > materials["tyre"].metallic


def test_normals_keep_edges_and_smooth_curves():
    box = trimesh.creation.box()
    creased = creased_mesh(box.vertices, np.asarray(box.faces))
    assert len(creased.vertices) == 24
    assert np.abs(creased.vertex_normals).max(axis=1) == pytest.approx(1.0)
    ball = trimesh.creation.icosphere(subdivisions=3)
    smooth = creased_mesh(ball.vertices, np.asarray(ball.faces))
    assert len(smooth.vertices) == len(ball.vertices)
    assert (smooth.vertex_normals * smooth.vertices).sum(axis=1).min() > 0.999


# Another robot: a box with one mast, in a robot file of its own.
CART_YAML = """
name: cart
size_m: [0.30, 0.24, 0.20]
radius_m: 0.20
mass_kg: 4.0
max_speed_mps: 0.5
max_turn_rate_radps: 2.0
chassis: {radius_m: 0.12, centre_x_m: -0.02, bottom_z_m: 0.02, top_z_m: 0.12}
wheels: {radius_m: 0.05, width_m: 0.02, track_m: 0.20, mass_kg: 0.1}
caster: {x_m: -0.12, radius_m: 0.01}
lidar: {x_m: 0.0, z_m: 0.18, cap_radius_m: 0.03, beams: 180, rate_hz: 5.0, range_min_m: 0.1, \
range_max_m: 4.0, no_echo_free_m: 3.0, \
noise: {sigma_m: 0.01, sigma_ratio: 0.01, step_m: 0.001, dropout: 0.01}}
camera: {xyz_m: [0.15, 0.0, 0.1], rpy_rad: [0.0, 0.0, 0.0], fx_px: 300.0, fy_px: 300.0, cx_px: 159.5, \
cy_px: 119.5, width_px: 320, height_px: 240}
cuboid: {size_m: [0.30, 0.24, 0.20], centre_m: [0.0, 0.0, 0.10]}
"""


def _cart() -> dict[str, tuple[trimesh.Trimesh, Material]]:
    body = trimesh.creation.box([0.30, 0.24, 0.10]).apply_translation([0.0, 0.0, 0.07])
    mast = trimesh.creation.cylinder(0.03, 0.08).apply_translation([0.0, 0.0, 0.16])
    return {"mast": (mast, RED), "body": (body, BLUE)}


def test_another_robot_takes_a_file_and_a_model(tmp_path: Path):
    (tmp_path / "robot.yaml").write_text(CART_YAML)
    (tmp_path / "robot.glb").write_bytes(robot_glb(_cart()))
    parts = robot_parts((tmp_path / "robot.glb").read_bytes(), source="own")
    assert list(parts) == ["body", "mast"]
    assert parts["body"].bounds == pytest.approx(
        np.array([[-0.15, -0.12, 0.02], [0.15, 0.12, 0.12]]), abs=1e-6
    )
    assert part_material(parts["body"]) == _approx(BLUE)
    assert part_material(parts["mast"]) == _approx(RED)
    check_inside_cuboid(parts, load_robot(str(tmp_path / "robot.yaml")).cuboid, robot="cart")


def _approx(material: Material) -> Material:
    """The material after glTF has stored its colour in bytes."""
    rgb = tuple(float(np.round(255 * c) / 255) for c in material.base_colour_rgb)
    return Material(base_colour_rgb=rgb, metallic=material.metallic, roughness=material.roughness)


def test_a_model_that_others_wrote_is_placed_by_its_nodes():
    scene = trimesh.Scene()
    scene.add_geometry(
        trimesh.creation.box([0.1, 0.1, 0.1]), node_name="body", transform=_shift(0.0, 0.0, 0.05)
    )
    parts = robot_parts(scene.export(file_type="glb"), source="own")
    assert parts["body"].bounds == pytest.approx(np.array([[-0.05, -0.05, 0.0], [0.05, 0.05, 0.1]]), abs=1e-6)
    assert part_material(parts["body"]).metallic == 0.0


def test_a_part_takes_gltfs_defaults_for_what_its_material_leaves_open():
    part = trimesh.creation.box()
    part.visual = trimesh.visual.TextureVisuals(material=PBRMaterial(name="bare"))
    assert part_material(part) == Material(base_colour_rgb=(1.0, 1.0, 1.0), metallic=1.0, roughness=1.0)
    assert part_material(trimesh.creation.box()) == Material(base_colour_rgb=(1.0, 1.0, 1.0))


def _shift(*xyz_m: float) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = xyz_m
    return T


def test_a_model_in_millimetres_is_refused():
    mesh, _ = _cart()["body"]
    cuboid = Cuboid(size_m=(0.3, 0.24, 0.2), centre_m=(0.0, 0.0, 0.1))
    parts = {"body": mesh.copy().apply_scale(1000.0)}
    with pytest.raises(
        ConfigError, match=r"cart: part 'body' reaches 149850\.0 mm out of the cuboid along x"
    ):
        check_inside_cuboid(parts, cuboid, robot="cart")


@pytest.mark.parametrize("damaged", [b"", b"solid cube", (b"glTF" + bytes(40))])
def test_a_damaged_model_is_named(damaged):
    with pytest.raises(ConfigError, match=rf"own.glb: {len(damaged)} bytes that cannot be read as GLB"):
        robot_parts(damaged, source="own.glb")


def test_a_model_without_meshes_is_named():
    lines = trimesh.Scene([trimesh.load_path(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))])
    with pytest.raises(ConfigError, match="no mesh in the GLB"):
        robot_parts(lines.export(file_type="glb"), source="own.glb")


def test_a_model_fills_at_least_half_of_each_side_of_its_cuboid():
    cuboid = Cuboid(size_m=(0.3, 0.3, 0.3), centre_m=(0.0, 0.0, 0.0))
    check_inside_cuboid({"body": trimesh.creation.box([0.16, 0.3, 0.3])}, cuboid, robot="own")
    with pytest.raises(ConfigError, match=r"fills 46\.7% of the cuboid along x"):
        check_inside_cuboid({"body": trimesh.creation.box([0.14, 0.3, 0.3])}, cuboid, robot="own")


def test_a_model_in_kilometres_is_refused(burger):
    small = {name: part.copy().apply_scale(0.001) for name, part in burger.items()}
    with pytest.raises(ConfigError, match=r"fills 0\.1% of the cuboid along .*is it in metres"):
        check_inside_cuboid(small, load_robot("burger").cuboid, robot="burger")
