from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from rendezvous.robot_file import ROBOTS
from tests.stages.published_images import (
    ABSENT,
    BURGER,
    HIDDEN,
    corners_cm,
    exported,
    files,
    grey,
    label_columns,
    pose_row,
    publish,
    publish_all,
    rendezvous,
)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dataset")
    publish_all(folder)
    return folder


@pytest.fixture(scope="module")
def bop(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Ten images at most of each split as BOP wants them, and what the command printed."""
    out = tmp_path_factory.mktemp("bop")
    return out, exported("bop", dataset, "--out", out, "--split", "all", "--count", 10)


def _read(path: Path) -> dict:
    """As the toolkit reads it: keys are numbers."""
    return {int(key): value for key, value in json.loads(path.read_text()).items()}


def test_a_bop_dataset_has_its_files(bop):
    out, told = bop
    scenes = [
        f"{split}/000000/{name}"
        for split, images in (("train", 10), ("val", 6), ("test", 10))
        for name in (
            *(f"rgb/{i:06d}.png" for i in range(images)),
            "scene_camera.json",
            "scene_gt.json",
            "scene_gt_info.json",
        )
    ]
    top = ["camera.json", "models/models_info.json", "models/obj_000001.ply", "test_targets_bop19.json"]
    assert files(out) == sorted(scenes + top)
    assert told == (
        f"26 images in {out} (10 in train/, 6 in val/, 10 in test/), 20 of which show 'burger', object 1; "
        "6 test targets\n"
    )


def test_bop_poses_project_the_model_where_the_cuboid_is(bop):
    out, _ = bop
    scene = out / "train" / "000000"
    cameras, truths = _read(scene / "scene_camera.json"), _read(scene / "scene_gt.json")
    assert list(cameras) == list(truths) == list(range(10))
    corners_mm = 10.0 * corners_cm(*(100.0 * side for side in BURGER.cuboid.size_m))
    for i, entries in truths.items():
        if i == ABSENT:
            assert entries == []
            continue
        (entry,) = entries
        assert set(entry) == {"obj_id", "cam_R_m2c", "cam_t_m2c"}
        assert entry["obj_id"] == 1
        T_c_o = label_columns(i)["T_c_o"]
        assert entry["cam_t_m2c"] == pytest.approx(1000.0 * T_c_o[:3, 3])
        R, K = np.reshape(entry["cam_R_m2c"], (3, 3)), np.reshape(cameras[i]["cam_K"], (3, 3))
        p = (corners_mm @ R.T + entry["cam_t_m2c"]) @ K.T
        assert p[:, :2] / p[:, 2:] == pytest.approx(label_columns(i)["projected_cuboid_px"])


def test_bop_boxes_are_corner_and_size(bop):
    out, _ = bop
    infos = _read(out / "train" / "000000" / "scene_gt_info.json")
    assert HIDDEN in infos
    assert sum(len(entries) for entries in infos.values()) > 1
    for i, entries in infos.items():
        label = label_columns(i)
        for entry in entries:
            assert entry["px_count_all"] == 2000
            assert entry["px_count_visib"] == label["visible_px"]
            assert entry["visib_fract"] == label["visibility"]
            if i == HIDDEN:
                assert entry["bbox_visib"] == entry["bbox_obj"] == [-1, -1, -1, -1]
                continue
            assert entry["bbox_visib"] == [10, 20, 19, 2]
            x, y, width, height = entry["bbox_obj"]
            uv_px = label["projected_cuboid_px"]
            assert (uv_px.min(axis=0) <= [x, y]).all()
            assert (uv_px.max(axis=0) >= [x + width, y + height]).all()
            # The Burger fills its cuboid to all sides, if not to its corners.
            assert (np.array([width, height]) > 0.6 * np.ptp(uv_px, axis=0)).all()


def test_the_test_targets_are_the_images_that_show_a_tenth_of_the_robot(bop):
    out, _ = bop
    targets = json.loads((out / "test_targets_bop19.json").read_text())
    assert [target["im_id"] for target in targets] == [2, 4, 6, 7, 8, 9]
    assert all(label_columns(target["im_id"])["visibility"] >= 0.1 for target in targets)
    assert all(t == t | {"scene_id": 0, "obj_id": 1, "inst_count": 1} and len(t) == 4 for t in targets)


def test_only_the_test_split_has_targets(dataset, tmp_path):
    exported("bop", dataset, "--out", tmp_path, "--count", 2)
    assert not (tmp_path / "test_targets_bop19.json").exists()


def test_bops_model_is_the_robot_in_millimetres(bop):
    out, _ = bop
    mesh = trimesh.load_mesh(out / "models" / "obj_000001.ply")
    half_mm = 500.0 * np.array(BURGER.cuboid.size_m)
    assert np.abs(mesh.bounds) == pytest.approx(np.array([half_mm, half_mm]), abs=0.6)
    info = json.loads((out / "models" / "models_info.json").read_text())
    assert list(info) == ["1"]
    assert info["1"]["size_z"] == pytest.approx(np.ptp(mesh.vertices[:, 2]), abs=1e-3)
    camera = json.loads((out / "camera.json").read_text())
    assert camera == {
        "fx": 616.0,
        "fy": 616.0,
        "cx": 319.5,
        "cy": 239.5,
        "width": 640,
        "height": 480,
        "depth_scale": 1.0,
    }


def test_an_image_with_a_robot_that_reaches_behind_the_camera_is_left_out(tmp_path):
    T_c_o = np.eye(4)
    T_c_o[2, 3] = 0.05
    publish(tmp_path, "train", [[pose_row(0), pose_row(1, T_c_o=T_c_o), pose_row(2)]])
    told = exported("bop", tmp_path, "--out", tmp_path / "out")
    assert told.endswith("; 1 left out: a part of the robot is behind the camera\n")
    scene = tmp_path / "out" / "train" / "000000"
    assert list(_read(scene / "scene_gt_info.json")) == [0, 1]
    assert cv2.imread(str(scene / "rgb" / "000001.png"))[0, 0, 0] == pytest.approx(grey(2), abs=1)


@pytest.fixture
def rover(tmp_path: Path) -> tuple[Path, Path]:
    """A dataset of a robot that does not come with the project, and its robot file."""
    data, robot = tmp_path / "dataset", tmp_path / "rover"
    robot.mkdir()
    text = (ROBOTS / "burger" / "robot.yaml").read_text()
    (robot / "robot.yaml").write_text(text.replace("name: burger", "name: rover"))
    (robot / "robot.glb").write_bytes((ROBOTS / "burger" / "robot.glb").read_bytes())
    publish(data, "train", [[pose_row(i, robot="rover") for i in range(2)]])
    return data, robot / "robot.yaml"


def test_bop_takes_another_robots_model_from_its_file(rover, tmp_path):
    data, robot = rover
    told = exported("bop", data, "--out", tmp_path / "out", "--robot", robot)
    assert "2 of which show 'rover', object 1" in told


def test_bop_says_how_to_name_a_robot_that_it_does_not_know(rover, tmp_path):
    data, _ = rover
    code, _, fault = rendezvous("bop", data, "--out", tmp_path / "out")
    assert code == 2
    assert "robot 'rover': no file " in fault
    assert fault.endswith("; --robot PATH names the robot file of the 'rover'\n")


@pytest.mark.parametrize(
    ("was", "becomes", "said"),
    [
        ("size_m: [0.138", "size_m: [0.158", r"a cuboid of \(0\.158, .*; the dataset's is of \(0\.138, "),
        (
            "centre_m: [-0.032",
            "centre_m: [-0.022",
            r"around \(-0\.022, .*; the dataset's .* around \(-0\.032, ",
        ),
    ],
)
def test_bop_refuses_a_robot_with_another_cuboid_than_the_datasets(was, becomes, said, rover, tmp_path):
    data, robot = rover
    robot.write_text(robot.read_text().replace(was, becomes))
    code, _, fault = rendezvous("bop", data, "--out", tmp_path / "out", "--robot", robot)
    assert code == 2
    assert re.search(said + r".* so --robot must name another robot file$", fault)
    assert not (tmp_path / "out").exists()


def test_a_failed_bop_export_leaves_no_documents_beside_other_images(dataset, tmp_path):
    out = tmp_path / "out"
    exported("bop", dataset, "--out", out, "--count", 3)
    publish(tmp_path, "train", [[pose_row(0), pose_row(1, image=b"\xff\xd8\xff"), pose_row(2)]])
    assert rendezvous("bop", tmp_path, "--out", out)[0] == 2
    assert not list(out.rglob("scene_*.json"))


def test_bop_says_where_a_model_is_missing(rover, tmp_path):
    data, robot = rover
    robot.with_suffix(".glb").unlink()
    code, _, fault = rendezvous("bop", data, "--out", tmp_path / "out", "--robot", robot)
    assert code == 2
    assert f"no model {robot.with_suffix('.glb')} (no such file or directory)" in fault
    assert fault.count("\n") == 1
