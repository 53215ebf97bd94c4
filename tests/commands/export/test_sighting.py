"""A published pair as files for `fuse`: what the command then reads is what the row holds."""

import json
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from typer.testing import CliRunner

from rendezvous.cli.__main__ import app
from rendezvous.commands.export.sighting import _best_seen, _body_pose, export_sighting
from rendezvous.geometry.camera import camera_pose
from rendezvous.geometry.occupancy_grid import grid_from_png
from rendezvous.geometry.se2 import SE2
from rendezvous.interop.camera_info import read_camera_info
from rendezvous.interop.ros_map import read_ros_map
from rendezvous.schema import PAIRS
from rendezvous.stages.pack import pack
from rendezvous.store.read import StageReader
from tests.stages.published_images import exported, rendezvous
from tests.synthetic_dataset import explored, rendered, synthetic_run


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset with images."""
    folder = tmp_path_factory.mktemp("seen")
    explored(folder)
    pack(synthetic_run(folder))
    return folder / "dataset"


def row_of(dataset: Path) -> dict:
    """The first of the test split."""
    return rows_of(dataset)[0]


def rows_of(dataset: Path) -> list[dict]:
    """Of the first file of the test split."""
    reader = StageReader(str(dataset), "pack")
    names = sorted(shard.name for shard in reader.shards() if shard.name.startswith("pairs/test-"))
    return PAIRS.rows(reader.table(names[0]))


def options(command: str) -> dict[str, str]:
    words = shlex.split(command.replace("=", " "))
    assert words[:2] == ["rendezvous", "fuse"]
    return dict(zip(words[2::2], words[3::2], strict=True))


def test_maps_poses_image_and_camera_are_those_of_the_row(seen: Path, tmp_path: Path):
    row = row_of(seen)
    command = export_sighting(str(seen), row["pair_id"], tmp_path)
    assert (tmp_path / "command.txt").read_text() == f"{command}\n"
    told = options(command)
    for i in (0, 1):
        grid = read_ros_map(Path(told[f"--map{i}"]), strict=True)
        stored = grid_from_png(row[f"map_{i}"], resolution_m=row["resolution_m"], T_m_g=row[f"origin_{i}"])
        np.testing.assert_array_equal(grid.cells, stored.cells)
        assert grid == replace(stored, cells=grid.cells)
        pose = [float(word) for word in told[f"--pose{i}"].split(",")]
        assert pose == pytest.approx(row[f"T_m{i}_r{i}"].as_array(), abs=1e-4)
    np.testing.assert_array_equal(read_camera_info(Path(told["--camera"])).camera.K(), row["K"])
    mounted = np.array([float(word) for word in told["--camera-pose"].split(",")])
    np.testing.assert_allclose(camera_pose(mounted[:3], mounted[3:]), row["T_r0_c"], atol=1e-5)
    assert Path(told["--image"]).read_bytes().startswith(b"\x89PNG")


def test_without_a_name_it_is_the_first_that_shows_the_whole_robot(seen: Path, tmp_path: Path):
    rows = rows_of(seen)
    whole = [row["visibility"] >= 0.95 for row in rows]
    assert not all(whole)
    chosen = rows[whole.index(True) if any(whole) else 0]
    told = exported("sighting", "--out", tmp_path / "one", seen)
    assert told.replace("/one/", "/two/") == exported(
        "sighting", "--out", tmp_path / "two", "--pair", chosen["pair_id"], seen
    )


@pytest.mark.parametrize(
    ("shares", "index"), [([0.5, None, 0.97, 1.0], 2), ([0.5, 0.94, 0.95], 2), ([0.5, 0.9], 0), ([None], 0)]
)
def test_the_whole_robot_comes_before_a_part_of_it(shares, index):
    assert _best_seen(pa.table({"visibility": pa.array(shares, pa.float64())})) == index


def test_a_name_that_is_not_there_is_told(seen: Path, tmp_path: Path):
    code, _, faults = rendezvous("sighting", "--out", tmp_path, "--pair", "plan-xyz", seen)
    assert code == 2
    assert "no pair 'plan-xyz'; there are plan-0" in faults
    assert list(tmp_path.iterdir()) == []


def test_a_folder_without_pairs_is_told(seen: Path, tmp_path: Path):
    code, _, faults = rendezvous("sighting", "--out", tmp_path, seen.parent / "explore")
    assert code == 2
    assert "explore: holds no pairs; must be a dataset that `rendezvous pack` published" in faults


def test_without_an_image_the_command_fuses_by_the_true_relative_pose(tmp_path: Path):
    explored(tmp_path)
    rendered(tmp_path, views=False)
    pack(synthetic_run(tmp_path))
    row = row_of(tmp_path / "dataset")
    command = export_sighting(str(tmp_path / "dataset"), None, tmp_path / "out")
    assert not (tmp_path / "out" / "image.png").exists()
    shown = CliRunner().invoke(app, [*shlex.split(command)[1:], "--refine", "none"])
    assert shown.exit_code == 0, shown.output
    record = json.loads((tmp_path / "out" / "fused" / "result.json").read_text())
    T_m0_m1 = SE2(**record["T_m0_m1"])
    left = (T_m0_m1.inverse() @ row["T_m0_m1_local"]).wrapped()
    assert left.as_array() == pytest.approx(np.zeros(3), abs=1e-3)


def test_a_cameras_pose_is_told_as_fuse_reads_it_however_it_is_turned():
    mounted = np.array([0.1, -0.2, 0.3, 0.4, -0.5, 0.6])
    np.testing.assert_allclose(_body_pose(camera_pose(mounted[:3], mounted[3:])), mounted, atol=1e-12)
