"""Pictures of sightings that were really driven, and training images, on one small plan."""

from __future__ import annotations

import json
import shutil
import sys
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
import yaml

from rendezvous.errors import ConfigError, SetupError, StoreError
from rendezvous.geometry.camera import PinholeCamera
from rendezvous.geometry.cuboid import pose_from_cuboid
from rendezvous.geometry.se2 import SE2
from rendezvous.rendering.opengl.gl import check_libraries, renderer_name
from rendezvous.rendering.robot_model import robot_glb
from rendezvous.rendering.scene import Material
from rendezvous.robot_file import ROBOTS, load_robot
from rendezvous.schema import EXPLORE, POSES, VIEWS
from rendezvous.stages.explore import explore
from rendezvous.stages.floorplans import floorplans
from rendezvous.stages.meshes import meshes
from rendezvous.stages.render import check_pictures, render
from rendezvous.store.read import StageReader
from tests.conftest import MakeRun, run_in

ONE_PLAN = (
    "floorplans.sources=[floorplans/rdv-008.json]",
    "floorplans.generate.count=0",
    "explore.episodes_per_plan=3",
    "explore.episode.max_time_s=60",
    "render.poses_per_plan=6",
)


@pytest.fixture(autouse=True, scope="module")
def _needs_gl():
    try:
        check_libraries()
    except SetupError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A data folder with the output of all stages up to `explore`, and of `render`."""
    data = str(tmp_path_factory.mktemp("render"))
    run = run_in(data, ONE_PLAN)
    for stage in (floorplans, meshes, explore, render):
        stage(run)
    return data


def _rows(reader: StageReader, schema, under: str = ""):
    return [row for shard in reader.shards(under) for row in schema.rows(reader.table(shard.name))]


def _tables(data: str):
    """Sightings and their views by pair id, and the training images."""
    run = run_in(data, ONE_PLAN)
    sightings = {row["pair_id"]: row for row in _rows(run.read("explore"), EXPLORE)}
    views = {row["pair_id"]: row for row in _rows(run.read("render"), VIEWS, "views/")}
    poses = _rows(run.read("render"), POSES, "poses/")
    assert sightings
    assert views
    assert len(poses) == 6
    return sightings, views, poses


def test_each_sighting_has_one_view_with_the_robot_where_it_was(driven: str) -> None:
    sightings, views, _ = _tables(driven)
    assert views.keys() == sightings.keys() > set()
    for pair_id, view in views.items():
        row = sightings[pair_id]
        T_r0_r1 = row["T_r0_c"] @ view["T_c_o"] @ np.linalg.inv(row["T_r1_o"])
        yaw_rad = np.arctan2(T_r0_r1[1, 0], T_r0_r1[0, 0])
        found = SE2(T_r0_r1[0, 3], T_r0_r1[1, 3], yaw_rad).wrapped()
        assert found.as_array() == pytest.approx(row["T_r0_r1_true"].as_array(), abs=1e-9)
        assert T_r0_r1[2] == pytest.approx([0.0, 0.0, 1.0, 0.0], abs=1e-9)


def test_images_have_the_cameras_size_and_labels_give_the_pose_back(driven: str) -> None:
    sightings, views, poses = _tables(driven)
    labelled = [(views[i], sightings[i]) for i in views] + [(row, row) for row in poses]
    assert len(labelled) >= 9
    for label, row in labelled:
        assert _pixels(label["image"]).shape == (row["image_height_px"], row["image_width_px"], 3)
        if label["T_c_o"] is None:
            continue
        height_px, width_px, _ = _pixels(label["image"]).shape
        camera = PinholeCamera.of_matrix(np.array(row["K"]).reshape(3, 3), width_px, height_px)
        T_c_o = pose_from_cuboid(label["projected_cuboid_px"], row["cuboid_size_m"], camera)
        turn = T_c_o[:3, :3].T @ label["T_c_o"][:3, :3]
        assert np.linalg.norm(T_c_o[:3, 3] - label["T_c_o"][:3, 3]) < 1e-3
        assert np.linalg.norm(cv2.Rodrigues(turn)[0]) < np.radians(0.1)


def test_what_the_sighting_test_saw_is_to_be_seen(driven: str) -> None:
    sightings, views, _ = _tables(driven)
    seen = [(sightings[i]["visible_fraction"], view["visibility"]) for i, view in views.items()]
    assert all(visibility > 0.25 for _, visibility in seen)
    assert np.mean([abs(fraction - visibility) for fraction, visibility in seen]) < 0.15


def test_rooms_and_robot_look_alike_in_all_of_an_episode_and_differ_between_episodes(driven: str) -> None:
    sightings, views, _ = _tables(driven)
    looks: dict[str, set[str]] = {}
    for pair_id, view in views.items():
        drawn = json.loads(view["drawn"])
        of_episode = looks.setdefault(sightings[pair_id]["episode_id"], set())
        of_episode.add(json.dumps([drawn["surfaces"], drawn["robot"]]))
    assert all(len(found) == 1 for found in looks.values())
    assert len(set.union(*looks.values())) == len(looks) > 1


@pytest.mark.slow
def test_pictures_of_changed_scenes_show_the_observers_furniture(tmp_path: Path) -> None:
    """What is seen of the other robot is what the sighting says."""
    changed = (*ONE_PLAN[:2], "explore.episodes_per_plan=6", "explore.episode.max_time_s=90")
    settings = ("explore.changed_share=1", "explore.episode.drive=planar", "render.poses_per_plan=0")
    run = run_in(str(tmp_path), (*changed, *settings))
    for stage in (floorplans, meshes, explore, render):
        stage(run)
    sightings = {row["pair_id"]: row for row in _rows(run.read("explore"), EXPLORE)}
    views = {row["pair_id"]: row for row in _rows(run.read("render"), VIEWS, "views/")}
    assert {row["observer"] for row in sightings.values()} == {0, 1}
    seen = [(row["visible_fraction"], views[pair_id]["visibility"]) for pair_id, row in sightings.items()]
    assert len(seen) >= 5
    assert all(visibility > 0.25 for _, visibility in seen)
    assert np.mean([abs(fraction - visibility) for fraction, visibility in seen]) < 0.15


def test_half_of_the_training_images_are_plausible_with_the_camera_on_a_robot(driven: str) -> None:
    _, _, poses = _tables(driven)
    modes = [row["mode"] for row in poses]
    assert modes in (["free", "plausible"] * 3, ["plausible", "free"] * 3)
    nominal = load_robot("burger").camera.T_r_c()
    for row in poses:
        assert (row["T_r0_c"] is None) == (row["mode"] == "free")
        if row["mode"] == "plausible":
            assert row["T_r0_c"] == pytest.approx(nominal)
            assert np.abs(row["T_r0_c_true"] - nominal).max() < 0.06
            assert not np.array_equal(row["T_r0_c_true"], nominal)
    assert {json.loads(row["drawn"])["renderer"] for row in poses} == {renderer_name()}


def test_more_training_images_leave_the_first_ones_and_the_views_as_they_were(driven: str) -> None:
    _, _, before = _tables(driven)
    run = run_in(driven, [*ONE_PLAN, "render.poses_per_plan=7"])
    kept = {shard.name: shard.sha256 for shard in run.read("render").shards("views/")}
    render(run)
    after = _rows(run.read("render"), POSES, "poses/")
    assert [row["image"] for row in after[:6]] == [row["image"] for row in before]
    assert len(after) == 7
    assert {shard.name: shard.sha256 for shard in run.read("render").shards("views/")} == kept
    assert "poses_per_plan changed 6 -> 7" in run.console.file.getvalue()
    render(run_in(driven, ONE_PLAN))


def test_without_the_robot_there_is_no_pose_cuboid_or_box(driven: str, tmp_path: Path) -> None:
    wanted = ("render.draws.absent_share=1.0", "render.views=false", "render.jpeg_quality=null")
    run = _beside(driven, tmp_path, *wanted)
    counts = render(run).counts()
    rows = _rows(run.read("render"), POSES)
    assert counts["poses_without_robot"] == counts["poses"] == len(rows) == 6
    for row in rows:
        assert [row[name] for name in ("T_c_o", "projected_cuboid_px", "box_px")] == [None] * 3
        assert (row["visibility"], row["visible_px"], row["silhouette_px"]) == (0.0, 0, 0)
        assert row["image"].startswith(b"\x89PNG")


def test_images_that_find_no_place_for_their_robots_are_left_out_with_the_reason(
    driven: str, tmp_path: Path
) -> None:
    far = ("render.draws.min_range_m=19", "render.draws.max_range_m=20", "render.views=false")
    run = _beside(driven, tmp_path, *far)
    manifest = render(run)
    assert manifest.counts()["poses_left_out"] == 3
    assert manifest.counts()["poses"] == 3
    assert "no place for two robots" in manifest.quarantined[0].reason


def test_photographs_have_the_size_and_camera_that_their_rows_say(driven: str, tmp_path: Path) -> None:
    wanted = ("render.draws.plausible_share=0", "render.draws.photo_share=1", "render.views=false")
    run = _beside(driven, tmp_path, *wanted, "render.draws.absent_share=0")
    render(run)
    rows = _rows(run.read("render"), POSES)
    assert len({row["image_width_px"] for row in rows}) > 1
    for row in rows:
        assert _pixels(row["image"]).shape[:2] == (row["image_height_px"], row["image_width_px"])
        K = np.array(row["K"]).reshape(3, 3)
        centre_px = K @ np.array(row["T_c_o"]).reshape(4, 4)[:3, 3]
        assert centre_px[:2] / centre_px[2] == pytest.approx(row["projected_cuboid_px"][8], abs=1e-3)


def test_own_photos_stand_behind_free_images(driven: str, tmp_path: Path) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    red = np.zeros((700, 900, 3), np.uint8)
    red[..., 2] = 200
    cv2.imwrite(str(folder / "red.png"), red)
    wanted = (
        f"render.backgrounds={folder}", "render.draws.plausible_share=0", "render.draws.photo_share=0",
        "render.views=false",
    )  # fmt: skip
    run = _beside(driven, tmp_path / "data", *wanted, "render.draws.absent_share=1")
    render(run)
    images = [_pixels(row["image"]) for row in _rows(run.read("render"), POSES)]
    redder = [np.median(image[..., 2].astype(float) - image[..., 0]) for image in images]
    assert np.median(redder) > 60.0
    assert all(
        '"background":{"style":"any","photo":0,' in row["drawn"] for row in _rows(run.read("render"), POSES)
    )


def test_another_robot_than_explore_drove_is_refused(driven: str, tmp_path: Path) -> None:
    own = _robot_file(tmp_path, name="other")
    run = run_in(driven, [*ONE_PLAN, f"explore.robot={own}"])
    with pytest.raises(ConfigError, match=r"explore\.robot\.name 'burger', now it is 'other'"):
        render(run)


def test_a_robot_without_a_model_is_told_where_it_belongs(driven: str, tmp_path: Path) -> None:
    own = _robot_file(tmp_path, name="burger")
    own.with_suffix(".glb").unlink()
    with pytest.raises(ConfigError, match=r"no model .*robot\.glb .*no such file.*beside the robot file"):
        render(run_in(driven, [*ONE_PLAN, f"explore.robot={own}"]))


def test_a_plan_that_meshes_has_lost_is_named(driven: str, tmp_path: Path) -> None:
    run = _beside(driven, tmp_path)
    other = ["floorplans.sources=[floorplans/rdv-000.json]", *ONE_PLAN[1:]]
    floorplans(run_in(run.data, other))
    meshes(run_in(run.data, other))
    with pytest.raises(StoreError, match=r"no plan 'rdv-008', on which .*explore has sightings"):
        render(run)


def test_without_blender_path_traced_pictures_are_refused_before_anything_is_made(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "bpy", None)
    with pytest.raises(SetupError, match=r"render\.engine cycles needs bpy.*\[pathtraced\]'` installs it"):
        check_pictures(run_in(str(tmp_path), [*ONE_PLAN, "render.engine=cycles"]))


@pytest.mark.slow
@pytest.mark.skipif(find_spec("bpy") is None, reason="needs the extra pathtraced")
def test_path_traced_pictures_have_the_labels_of_rasterised_ones(driven: str, tmp_path: Path) -> None:
    few = ("render.views=false", "render.poses_per_plan=2", "render.cycles_samples=1")
    rows = {}
    for engine in ("pyrender", "cycles"):
        run = _beside(driven, tmp_path / engine, *few, f"render.engine={engine}")
        render(run)
        rows[engine] = _rows(run.read("render"), POSES)
    assert "render: drawing with Cycles (bpy" in run.console.file.getvalue()
    for rasterised, traced in zip(*rows.values(), strict=True):
        assert rasterised.keys() == traced.keys()
        for name in rasterised.keys() - {"image", "drawn"}:
            assert np.array_equal(rasterised[name], traced[name]), name
        assert rasterised["image"] != traced["image"]
        drawn, as_well = json.loads(rasterised["drawn"]), json.loads(traced["drawn"])
        assert (drawn.pop("engine"), as_well.pop("engine")) == ("pyrender", "cycles")
        assert drawn.pop("renderer") != as_well.pop("renderer")
        assert drawn == as_well


@pytest.mark.slow
def test_a_robot_of_ones_own_goes_all_the_way(make_run: MakeRun, tmp_path: Path) -> None:
    own = _robot_file(tmp_path, name="scout")
    run = make_run([*ONE_PLAN, f"meshes.robot={own}", f"explore.robot={own}"])
    for stage in (floorplans, meshes, explore, render):
        stage(run)
    rows = _rows(run.read("render"), POSES, "poses/")
    assert {row["robot"] for row in rows} == {"scout"}
    assert all(row["cuboid_size_m"] == pytest.approx(SCOUT_SIZE_M) for row in rows)
    assert all(_pixels(row["image"]).shape == (240, 320, 3) for row in rows)
    whole = [row for row in rows if row["visibility"] == 1.0]
    assert whole
    for row in whole:
        low, high = row["projected_cuboid_px"].min(axis=0), row["projected_cuboid_px"].max(axis=0)
        assert (row["box_px"][:2] >= low - 1.0).all()
        assert (row["box_px"][2:] <= high + 1.0).all()
        # It fills its cuboid, so that its box does, too.
        assert (row["box_px"][2:] - row["box_px"][:2] > 0.9 * (high - low)).all()


SCOUT_SIZE_M = (0.20, 0.16, 0.12)


def _robot_file(folder: Path, *, name: str) -> Path:
    """A robot that is a block, with a smaller camera; `burger` is the Burger itself."""
    values = yaml.safe_load((ROBOTS / "burger" / "robot.yaml").read_text())
    model = (ROBOTS / "burger" / "robot.glb").read_bytes()
    if name != "burger":
        size, centre = list(SCOUT_SIZE_M), [-0.03, 0.0, 0.06]
        values |= {"name": name, "size_m": size, "cuboid": {"size_m": size, "centre_m": centre}}
        values["chassis"]["top_z_m"] = 0.10
        values["lidar"] |= {"z_m": 0.11}
        values["camera"] |= {
            "xyz_m": [0.07, 0.0, 0.08], "fx_px": 300.0, "fy_px": 300.0,
            "cx_px": 159.5, "cy_px": 119.5, "width_px": 320, "height_px": 240,
        }  # fmt: skip
        block = trimesh.creation.box(SCOUT_SIZE_M).apply_translation(centre)
        model = robot_glb({"block": (block, Material(base_colour_rgb=(0.1, 0.4, 0.2)))})
    path = folder / "robot.yaml"
    path.write_text(yaml.safe_dump(values))
    path.with_suffix(".glb").write_bytes(model)
    return path


def _beside(driven: str, data: Path, *overrides: str):
    """A run with other settings of `render`, in a folder that shares the stages before it."""
    for stage in ("floorplans", "meshes", "explore"):
        shutil.copytree(Path(driven) / stage, data / stage)
    return run_in(str(data), [*ONE_PLAN, *overrides])


def _pixels(image: bytes) -> np.ndarray:
    """(H, W, 3) uint8 BGR."""
    return cv2.imdecode(np.frombuffer(image, np.uint8), cv2.IMREAD_COLOR)
