"""`rendezvous slam`: map, path and error of a recorded log."""

import json
import sys

import numpy as np
import pytest
from typer.testing import CliRunner

from rendezvous.cli.__main__ import app
from rendezvous.config.load import load_config
from rendezvous.interop.carmen_log import read_carmen_log
from rendezvous.interop.ros_map import read_ros_map
from rendezvous.interop.trajectory_files import read_tum
from rendezvous.recorded.mapped import map_scans
from rendezvous.recorded.odometry import odometry_of
from rendezvous.seeds import stream
from tests.conftest import ROOT
from tests.recorded.drive import carmen_text, driven


@pytest.fixture(scope="module")
def mapped(tmp_path_factory):
    folder = tmp_path_factory.mktemp("slam")
    drive = driven()
    (folder / "drive.log").write_text(carmen_text(drive, head="NEFF 30\n"))
    between = [(i, i + 8) for i in range(0, 50, 5)]
    lines = []
    for i, j in between:
        x, y, yaw = drive.poses_w[j] - drive.poses_w[i]
        c, s = np.cos(drive.poses_w[i, 2]), np.sin(drive.poses_w[i, 2])
        lines.append(f"{drive.t_s[i]} {drive.t_s[j]} {c * x + s * y} {c * y - s * x} 0 0 0 {yaw}\n")
    (folder / "drive.relations").write_text("".join(lines))
    arguments = [folder / "drive.log", "--out", folder / "out", "--relations", folder / "drive.relations"]
    result = CliRunner().invoke(app, ["slam", *map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == 0
    return drive, folder / "out", result.output


def test_the_path_is_close_to_the_reference_by_both_measures(mapped):
    _, out, printed = mapped
    errors = json.loads((out / "slam.json").read_text())["errors"]
    assert errors["reference, whole path"]["translation_mean_m"] < 0.03
    assert errors["relations"]["translation_mean_m"] < 0.03
    assert errors["relations"]["rotation_std_rad"] < 0.01
    assert errors["relations"]["count"] == 10
    assert errors["relations"]["translation_mean_m"] < errors["odometry by relations"]["translation_mean_m"]
    assert "60 scans of 180 beams" in printed
    assert "relations: 0.0" in printed


def test_the_trajectory_is_the_path_by_stamps(mapped):
    drive, out, _ = mapped
    t_s, poses = read_tum(out / "trajectory.tum")
    assert t_s == pytest.approx(drive.t_s)
    x, y, yaw = drive.poses_w[0]
    c, s = np.cos(yaw), np.sin(yaw)
    in_w = poses[:, :2] @ np.array([[c, s], [-s, c]]) + [x, y]
    assert np.abs(in_w - drive.poses_w[:, :2]).max() < 0.06


def test_the_map_shows_the_room(mapped):
    drive, out, _ = mapped
    grid = read_ros_map(out / "map.yaml", strict=True)
    x, y, yaw = drive.poses_w[0]
    walls_m = grid.cell_centres(grid.occupied())
    c, s = np.cos(yaw), np.sin(yaw)
    walls_w = walls_m @ np.array([[c, s], [-s, c]]) + [x, y]
    right = (np.abs(walls_w[:, 0] - 9.0) < 0.1) & (walls_w[:, 1] > 0.0) & (walls_w[:, 1] < 4.0)
    assert right.sum() > 60
    assert np.abs(walls_w[:, 1]).min() < 0.05


def test_the_loops_are_counted_and_the_graph_is_written(mapped):
    drive, out, printed = mapped
    loops = json.loads((out / "slam.json").read_text())["loops"]
    assert loops["search"] == "correlative search"
    assert loops["submaps"] >= 1
    assert "loops by correlative search: 0 closed, 0 rejected as false" in printed
    lines = (out / "graph.g2o").read_text().splitlines()
    _, poses = read_tum(out / "trajectory.tum")
    vertices = [[float(v) for v in line.split()[2:]] for line in lines if line.startswith("VERTEX_SE2")]
    assert len(vertices) == len(drive.t_s) + loops["submaps"]
    assert np.array(vertices)[: len(poses), :2] == pytest.approx(poses[:, :2], abs=1e-5)
    assert sum(line.startswith("EDGE_SE2") for line in lines) > len(poses)


def test_without_loops_slam_is_that_of_the_simulated_robots(mapped, tmp_path):
    _, out, _ = mapped
    arguments = [str(out.parent / "drive.log"), "--no-loops", "--out", str(tmp_path)]
    result = CliRunner().invoke(app, ["slam", *arguments], catch_exceptions=False)
    assert result.exit_code == 0
    assert "loops by" not in result.output
    assert json.loads((tmp_path / "slam.json").read_text())["loops"] is None
    assert not (tmp_path / "graph.g2o").exists()
    log = read_carmen_log(out.parent / "drive.log")
    order = np.arange(len(log))
    section = load_config(ROOT / "stages.yaml").replay
    odometry = odometry_of(log, order, section.odometry, rng=stream(0, "slam", "odometry"))
    alone = map_scans(log, order, odometry, lidar=section.lidar, parameters=section.slam)
    assert read_tum(tmp_path / "trajectory.tum")[1][:, :2] == pytest.approx(alone.poses[:, :2], abs=1e-6)


def test_another_search_for_loops_is_one_line(mapped, tmp_path):
    _, out, _ = mapped
    arguments = [str(out.parent / "drive.log"), "--loop-search", "bag-of-words", "--out", str(tmp_path)]
    result = CliRunner().invoke(app, ["slam", *arguments])
    assert result.exit_code == 2
    assert "correlative" in result.stderr
    assert "matcher" in result.stderr


def test_the_matcher_without_torch_says_what_to_install(mapped, tmp_path, monkeypatch):
    _, out, _ = mapped
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "rendezvous.stages.weights.trained_estimators", raising=False)
    arguments = [str(out.parent / "drive.log"), "--loop-search", "matcher", "--out", str(tmp_path)]
    result = CliRunner().invoke(app, ["slam", *arguments])
    assert result.exit_code == 2
    assert "pip install 'rendezvous-fusion[fuse]'" in " ".join(result.stderr.split())


def test_relations_of_another_log_are_one_line(mapped, tmp_path):
    _, out, _ = mapped
    (tmp_path / "other.relations").write_text("5 5.2 0 0 0 0 0 0\n")
    arguments = [str(out.parent / "drive.log"), "--relations", str(tmp_path / "other.relations")]
    result = CliRunner().invoke(app, ["slam", *arguments, "--out", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert "none of its 1 relations lies between two scans" in result.stderr
