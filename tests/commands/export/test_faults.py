from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.stages.published_images import files, pose_row, publish, publish_all, publish_views_off, rendezvous


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dataset")
    publish_all(folder)
    return folder


def _no_poses(folder: Path) -> None:
    (folder / "poses").rename(folder / "elsewhere")


def _file_missing(folder: Path) -> None:
    (folder / "poses" / "train-00000-of-00002.parquet").unlink()


def _files_of_two_exports(folder: Path) -> None:
    publish(folder, "train", [[pose_row(0)]])


def _cut_short(folder: Path) -> None:
    path = folder / "poses" / "train-00001-of-00002.parquet"
    path.write_bytes(path.read_bytes()[:-20])


def _no_rows(folder: Path) -> None:
    publish(folder, "train", [[], []])


def _no_column(folder: Path) -> None:
    for path in (folder / "poses").glob("train-*"):
        pq.write_table(pq.read_table(path).drop_columns(["robot"]), path)


def _another_cuboid(folder: Path) -> None:
    publish(folder, "train", [[pose_row(0)], [pose_row(1, cuboid_size_m=(0.3, 0.2, 0.1))]])


@pytest.mark.parametrize("kind", ["dope", "bop"])
@pytest.mark.parametrize(
    ("alter", "options", "said"),
    [
        (_no_poses, (), r"DATA: no table 'poses'; --table must be one of those there: elsewhere, pairs$"),
        (_file_missing, (), r"DATA/poses: 1 files of train, by their names of 2; copy or pack"),
        (_files_of_two_exports, (), r"DATA/poses: 3 files of train, by their names of 1 or 2; copy or pack"),
        (_cut_short, (), r"DATA/poses/train-00001-of-00002\.parquet: cannot be read \(.+\); copy or pack"),
        (_no_rows, (), r"DATA/poses: no rows in train; there is nothing to export$"),
        (_no_column, (), r"DATA/poses/train-00000-of-00002\.parquet: no column 'robot'; of another version"),
        (None, ("--split", "test"), r"DATA/poses: no split 'test'; --split must .+ there: train, or all$"),
        (None, ("--split", "tset"), r"--split is 'tset'; must be one of train, validation, test, all$"),
        (None, ("--table", "maps"), r"--table is 'maps'; must be one of poses, pairs$"),
        (
            None,
            ("--table", "pairs"),
            r"DATA/pairs: pair-0 has no image; .+ where render\.views is true",
        ),
        (_another_cuboid, (), r"plan-p001: .*'burger' .*a cuboid of \(0\.3, 0\.2, 0\.1\) m"),
    ],
)
def test_what_is_not_there_is_said_in_one_line(
    kind: str, alter: Callable[[Path], None] | None, options: tuple[str, ...], said: str, tmp_path: Path
):
    data, out = tmp_path / "dataset", tmp_path / "out"
    publish(data, "train", [[pose_row(0)], [pose_row(1)]])
    publish_views_off(data)
    if alter is not None:
        alter(data)
    code, told, fault = rendezvous(kind, data, "--out", out, *options)
    assert (code, told) == (2, "")
    assert fault.count("\n") == 1
    assert re.match("rendezvous: " + said.replace("DATA", re.escape(str(data))), fault.rstrip("\n")), fault
    assert not list(out.rglob("scene_*.json"))


@pytest.mark.parametrize("kind", ["dope", "bop"])
def test_a_folder_that_holds_no_dataset_is_named(kind, tmp_path):
    code, _, fault = rendezvous(kind, tmp_path / "nowhere", "--out", tmp_path / "out")
    assert code == 2
    assert fault.startswith(f"rendezvous: {tmp_path}/nowhere: no dataset here; must be a folder that")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("width_px", "height_px"), [(320, 240), (640, 399), (399, 640)])
def test_images_that_dope_cannot_crop_are_refused(tmp_path, width_px, height_px):
    publish(tmp_path, "train", [[pose_row(0, image_width_px=width_px, image_height_px=height_px)]])
    code, _, fault = rendezvous("dope", tmp_path, "--out", tmp_path / "out")
    assert code == 2
    assert f"plan-p000: {width_px}x{height_px} px; DOPE's loader crops images to 400x400" in fault
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("kind", ["dope", "bop"])
def test_an_output_that_is_a_file_is_one_line(kind, dataset, tmp_path):
    out = tmp_path / "taken"
    out.write_text("mine")
    code, _, fault = rendezvous(kind, dataset, "--out", out)
    assert code == 2
    assert fault.count("\n") == 1
    assert re.match(rf"rendezvous: {re.escape(str(out))}.*: cannot be written \(not a directory\)", fault)
    assert out.read_text() == "mine"


def test_a_disk_that_takes_no_more_is_one_line(dataset, tmp_path, monkeypatch):
    whole = Path.write_bytes

    def full(path: Path, content: bytes) -> int:
        if path.name.startswith("000001.png"):
            whole(path, content[:10])
            raise OSError(28, os.strerror(28))
        return whole(path, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    code, _, fault = rendezvous("dope", dataset, "--out", tmp_path, "--count", 3)
    assert code == 2
    assert fault.startswith(f"rendezvous: {tmp_path}/000001.png: cannot be written (no space left on device)")
    # The third image may have been begun by then, or not; whatever was, is whole.
    others = {name.split(".")[0] for name in files(tmp_path)}
    assert "000000" in others <= {"000000", "000002"}
    assert files(tmp_path) == sorted(f"{name}.{kind}" for name in others for kind in ("json", "png"))
