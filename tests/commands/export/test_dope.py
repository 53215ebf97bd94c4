from __future__ import annotations

import io
import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from rich.console import Console

from rendezvous.commands.export.dataset_images import ImageTable, Split
from rendezvous.commands.export.dope import export_dope
from rendezvous.interop.dope_json import read_dope_document
from tests.geometry.test_cuboid import error
from tests.stages.published_images import (
    ABSENT,
    CAMERA,
    FIRST_FILE,
    HIDDEN,
    ROWS,
    corners_cm,
    encoded,
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
def dope(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The training images for DOPE, and what the command printed."""
    out = tmp_path_factory.mktemp("dope") / "made" / "here"
    return out, exported("dope", dataset, "--out", out)


def _keypoints_as_dope_loads_them(path_json: Path, objects: list[str]) -> list[list[list[float]]]:
    """The steps of DOPE's own loader from a file to the points it augments."""
    document = json.loads(path_json.read_text())
    points = []
    for entry in document["objects"]:
        if entry["class"] not in objects:
            continue
        if entry["visibility"] > 0:
            cuboid = entry["projected_cuboid"]
            points.append([*cuboid, entry["projected_cuboid_centroid"]] if len(cuboid) == 8 else cuboid)
        else:
            points.append([[-100, -100]] * 9)
    return points or [[[-100, -100]] * 9]


def test_dopes_loader_finds_every_image_and_its_own_points(dope):
    out, _ = dope
    pairs = [
        (path, path.with_suffix(".json"))
        for path in sorted(out.rglob("*.png"))
        if path.with_suffix(".json").exists()
    ]
    assert [path.name for path, _ in pairs] == [f"{i:06d}.png" for i in range(ROWS)]
    assert len(files(out)) == 2 * ROWS
    for i, (path_img, path_json) in enumerate(pairs):
        image = cv2.imread(str(path_img))
        assert image.shape == (480, 640, 3)
        assert np.abs(image.astype(int) - grey(i)).max() <= 1
        (points,) = _keypoints_as_dope_loads_them(path_json, ["burger"])
        if i % 10 in (ABSENT, HIDDEN):
            assert points == [[-100, -100]] * 9
        else:
            assert np.array(points) == pytest.approx(label_columns(i)["projected_cuboid_px"])


def test_the_png_has_the_pixels_of_the_stored_jpeg(tmp_path: Path):
    rng = np.random.default_rng(0)
    scene = cv2.resize(rng.integers(0, 256, (30, 40, 3), np.uint8), (640, 480))  # uneven, and not grey
    jpeg = bytes(cv2.imencode(".jpg", scene)[1])
    publish(tmp_path, "train", [[pose_row(0, image=jpeg)]])
    exported("dope", tmp_path, "--out", tmp_path / "out")
    stored = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert np.array_equal(cv2.imread(str(tmp_path / "out" / "000000.png")), stored)


def test_a_stored_png_is_copied(tmp_path: Path):
    publish(tmp_path, "train", [[pose_row(0, image=encoded(0, ".png"))]])
    exported("dope", tmp_path, "--out", tmp_path / "out")
    assert (tmp_path / "out" / "000000.png").read_bytes() == encoded(0, ".png")


def test_the_printed_configuration_and_the_files_give_the_pose_back(dope):
    out, told = dope
    summary, train, *config = told.splitlines()
    assert summary == f"{ROWS} images in {out}, {ROWS - 2 * 8} with 'burger'"
    assert train == f"train.py: --data {out} --object burger"
    settings = yaml.safe_load("\n".join(config))
    assert settings["config_pose.yaml"]["class_ids"] == {"burger": 1}
    cuboid_cm = corners_cm(*settings["config_pose.yaml"]["dimensions"]["burger"])
    info = settings["camera_info.yaml"]
    assert (info["image_width"], info["image_height"]) == (640, 480)
    K = np.array(info["projection_matrix"]["data"]).reshape(3, 4)[:, :3]
    solved = 0
    for path in sorted(out.glob("*.json")):
        for entry in json.loads(path.read_text())["objects"]:
            uv_px = np.array(entry["projected_cuboid"])
            found, rvec, tvec_cm = cv2.solvePnP(
                cuboid_cm, uv_px, K, np.zeros((4, 1)), flags=cv2.SOLVEPNP_EPNP
            )
            assert found
            assert tvec_cm.ravel() == pytest.approx(entry["location"], abs=0.1)
            T_solved = np.eye(4)
            T_solved[:3, :3], T_solved[:3, 3] = cv2.Rodrigues(rvec)[0], tvec_cm.ravel() / 100.0
            distance_m, angle_rad = error(label_columns(int(path.stem))["T_c_o"], T_solved)
            assert distance_m < 1e-3
            assert angle_rad < np.radians(0.1)
            solved += 1
    assert solved == ROWS - 2 * 8


def test_dopes_files_are_read_back_as_the_labels(dope):
    out, _ = dope
    for i in (0, FIRST_FILE, ROWS - 1):
        path = out / f"{i:06d}.json"
        camera, (seen,) = read_dope_document(json.loads(path.read_text()), source=path.name)
        assert camera == CAMERA
        assert seen.T_c_o == pytest.approx(label_columns(i)["T_c_o"], abs=1e-9)
        assert seen.visibility == label_columns(i)["visibility"]


def test_all_splits_are_numbered_through_and_count_is_of_each(dataset, tmp_path):
    told = exported("dope", dataset, "--out", tmp_path, "--split", "all", "--count", 8)
    assert told.startswith("22 images in ")
    greys = [int(cv2.imread(str(tmp_path / f"{i:06d}.png"))[0, 0, 0]) for i in range(22)]
    assert greys == pytest.approx([grey(i) for i in [*range(8), *range(6), *range(8)]], abs=1)


def test_pairs_are_exported_like_poses(dataset, tmp_path):
    exported("dope", dataset, "--out", tmp_path, "--table", "pairs")
    assert files(tmp_path) == [f"{i:06d}.{suffix}" for i in range(4) for suffix in ("json", "png")]
    (points,) = _keypoints_as_dope_loads_them(tmp_path / "000002.json", ["burger"])
    assert np.array(points) == pytest.approx(label_columns(2)["projected_cuboid_px"])


def test_a_second_export_replaces_the_first(dataset, tmp_path):
    exported("dope", dataset, "--out", tmp_path, "--count", 3)
    before = {name: (tmp_path / name).read_bytes() for name in files(tmp_path)}
    (tmp_path / "000001.json").write_text("{")
    exported("dope", dataset, "--out", tmp_path, "--count", 3)
    assert {name: (tmp_path / name).read_bytes() for name in files(tmp_path)} == before


def test_a_shorter_export_does_not_mix_with_a_longer_one(dataset, tmp_path):
    exported("dope", dataset, "--out", tmp_path, "--count", 3)
    code, _, fault = rendezvous("dope", dataset, "--out", tmp_path, "--count", 2)
    assert code == 2
    assert fault == (
        f"rendezvous: {tmp_path}/000002.json: left by an export of more than the 2 images of this one; "
        "empty the folder, or name another with --out\n"
    )


def test_a_failed_export_leaves_no_label_beside_another_image(dataset, tmp_path):
    out = tmp_path / "out"
    exported("dope", dataset, "--out", out, "--count", 3)
    publish(tmp_path, "train", [[pose_row(0), pose_row(1, image=b"\xff\xd8\xff"), pose_row(2)]])
    code, _, fault = rendezvous("dope", tmp_path, "--out", out)
    assert code == 2
    assert fault == ("rendezvous: plan-p001: the image is damaged; `rendezvous verify` finds damaged files\n")
    assert "000001.json" not in files(out)
    assert "000000.json" in files(out)


def test_progress_is_told_in_batches(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr("rendezvous.engine.progress.LINE_EVERY_S", 0.0)
    console = Console(file=io.StringIO(), width=200)
    export_dope(
        str(dataset), tmp_path, table=ImageTable.POSES, split=Split.TRAIN, count=10**6, console=console
    )
    lines = console.file.getvalue().splitlines()
    assert [re.match(r"export: (\d/\d batches, \d+ images)", line)[1] for line in lines] == [
        "1/2 batches, 64 images",
        "2/2 batches, 80 images",
    ]
