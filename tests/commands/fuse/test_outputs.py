"""What `fuse` leaves in a folder: by its own record, by map_server's rules, and beside what was there."""

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from rendezvous.commands.fuse.from_python import fuse
from rendezvous.errors import ConfigError, StoreError
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN
from rendezvous.geometry.se2 import SE2
from rendezvous.interop.ros_map import read_ros_map, write_ros_map
from rendezvous.store.disk import Disk
from tests.commands.fuse.test_fuse import POSES, Seeing, given, maps
from tests.conftest import ROOT
from tests.fusion.test_system import T_R0_R1

__all__ = ["given"]  # a fixture


def matrix(pose: dict[str, float]) -> np.ndarray:
    c, s = np.cos(pose["yaw_rad"]), np.sin(pose["yaw_rad"])
    return np.array([[c, -s, pose["x_m"]], [s, c, pose["y_m"]], [0.0, 0.0, 1.0]])


def as_map_server_loads(path: Path) -> tuple[np.ndarray, float, list[float]]:
    """Cells from the bottom row (100 occupied, 0 free, -1 unknown), resolution, origin."""
    told = yaml.safe_load(path.read_text())
    magic, size, white, pixels = (path.parent / told["image"]).read_bytes().split(b"\n", 3)
    assert (magic, white, told["mode"], told["negate"]) == (b"P5", b"255", "trinary", 0)
    width, height = map(int, size.split())
    occupied = (255 - np.frombuffer(pixels, np.uint8).reshape(height, width)[::-1]) / 255.0
    cells = np.full(occupied.shape, -1)
    cells[occupied > told["occupied_thresh"]] = 100
    cells[occupied < told["free_thresh"]] = 0
    return cells, told["resolution"], told["origin"]


@pytest.mark.parametrize("refine", ["none", "correlative"])
def test_the_record_obeys_the_papers_equations(given: Path, tmp_path: Path, refine: str):
    error = T_R0_R1 @ SE2(0.2, -0.1, 0.1)
    fuse(*maps(given), **POSES, relative=error, relative_sigma=(0.2, 0.2, 0.1), refine=refine, out=tmp_path)
    told = json.loads((tmp_path / "result.json").read_text())
    T_m0_r0, T_m1_r1 = (matrix(told["inputs"][key]) for key in ("T_m0_r0", "T_m1_r1"))
    T_initial = T_m0_r0 @ matrix(told["sighting"][0]["T_r0_r1"]) @ np.linalg.inv(T_m1_r1)
    np.testing.assert_allclose(matrix(told["T_m0_m1_initial"]), T_initial, atol=1e-9)
    x_m, y_m = told["frame_error"]["window_centre_m0"]
    np.testing.assert_allclose((T_initial @ T_m1_r1)[:2, 2], [x_m, y_m], atol=1e-9)
    theta = told["frame_error"]["theta_w"]
    assert (theta is None) is (refine == "none")
    assert told["sighting"][0]["degrees_of_freedom"] is None
    C = matrix({"x_m": x_m, "y_m": y_m, "yaw_rad": 0.0})
    left = np.eye(3) if theta is None else C @ np.linalg.inv(matrix(theta)) @ np.linalg.inv(C)
    T_m0_m1 = matrix(told["T_m0_m1"])
    np.testing.assert_allclose(T_m0_m1, left @ T_initial, atol=1e-9)
    np.testing.assert_allclose(matrix(told["T_m1_m0"]) @ T_m0_m1, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(matrix(told["T_m0_r1"]), T_m0_m1 @ T_m1_r1, atol=1e-9)
    assert set(told["files"]) == {path.name for path in tmp_path.iterdir()} - {"result.json"}


@pytest.mark.parametrize("yaw_rad", [0.0, 0.4])
def test_the_map_loads_by_the_rules_of_map_server(given: Path, tmp_path: Path, yaw_rad: float):
    """Whatever the yaw of the maps it was made from, its own is 0: not all of ROS minds an origin's yaw."""
    turn = SE2(0.0, 0.0, yaw_rad)
    for number, path in enumerate(maps(given)):
        grid = read_ros_map(path, strict=True)
        object.__setattr__(grid, "T_m_g", turn @ grid.T_m_g)
        write_ros_map(grid, tmp_path / f"map{number}.yaml")
    poses = {name: turn @ T for name, T in POSES.items()}
    out = tmp_path / "out"
    result = fuse(*maps(tmp_path), **poses, relative=T_R0_R1, refine="none", out=out)
    cells, resolution_m, origin = as_map_server_loads(out / "fused.yaml")
    for value, meaning in ((OCCUPIED, 100), (FREE, 0), (UNKNOWN, -1)):
        np.testing.assert_array_equal(cells == meaning, result.grid.cells == value)
    assert resolution_m == result.grid.resolution_m
    assert origin == [*result.grid.T_m_g.as_array()[:2], 0.0]


def test_the_record_names_the_weights_that_were_used(given: Path, tmp_path: Path, monkeypatch):
    shipped = ROOT / "assets" / "weights" / "matcher.safetensors"
    own = tmp_path / "runs" / "matcher" / "weights.safetensors"
    monkeypatch.chdir(tmp_path)
    for refine, path in (("correlative", None), ("learned", shipped), ("learned", own)):
        if path == own:
            own.parent.mkdir(parents=True)
            own.write_bytes(shipped.read_bytes())
        fuse(*maps(given), **POSES, relative=T_R0_R1, refine=refine, out="out")
        told = json.loads(Path("out/result.json").read_text())["weights"]
        assert set(told) == ({"matcher"} if path else set())
        if path:
            assert Path(told["matcher"]["file"]).resolve() == path
            assert told["matcher"]["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()


def test_what_it_is_made_from_is_never_overwritten(given: Path, tmp_path: Path):
    shutil.copytree(given, tmp_path, dirs_exist_ok=True)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    seeing = Seeing(T_R0_R1)
    with pytest.raises(ConfigError, match=r"image\.png: would be overwritten; must not be named so in --out"):
        fuse(
            *maps(tmp_path),
            **POSES,
            image=tmp_path / "image.png",
            camera=tmp_path / "camera.yaml",
            refine="none",
            out=tmp_path / "x" / "..",
            pose_estimator=seeing,
        )
    assert not seeing.given, "it must be told before the work is done"
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_the_image_of_a_map_is_never_overwritten_either(given: Path, tmp_path: Path):
    """A fused map whose YAML file got another name still calls its image `fused.pgm`."""
    (tmp_path / "first.yaml").write_text((given / "map0.yaml").read_text().replace("map0.pgm", "fused.pgm"))
    shutil.copy(given / "map0.pgm", tmp_path / "fused.pgm")
    with pytest.raises(ConfigError, match=r"fused\.pgm: would be overwritten; must not be named so in --out"):
        fuse(tmp_path / "first.yaml", given / "map1.yaml", **POSES, relative=T_R0_R1, out=tmp_path)
    assert (tmp_path / "fused.pgm").read_bytes() == (given / "map0.pgm").read_bytes()


def test_pictures_that_it_did_not_make_stay(given: Path, tmp_path: Path):
    (tmp_path / "image_1.png").write_bytes(b"mine")
    (tmp_path / "result.json").write_text("[1, 2]")
    for _ in range(2):
        fuse(*maps(given), **POSES, relative=T_R0_R1, refine="none", out=tmp_path)
        assert (tmp_path / "image_1.png").read_bytes() == b"mine"


@pytest.mark.parametrize("full_after", [0, 2])
def test_a_full_disk_leaves_the_earlier_fusion_as_it_was(
    given: Path, tmp_path: Path, monkeypatch, full_after
):
    fuse(*maps(given), **POSES, relative=T_R0_R1, refine="none", out=tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    written, write = [], Disk.write

    def write_until_full(disk: Disk, name: str, data: bytes) -> None:
        if len(written) == full_after:
            raise StoreError(f"{name}: the disk is full")
        written.append(name)
        write(disk, name, data)

    monkeypatch.setattr(Disk, "write", write_until_full)
    with pytest.raises(StoreError, match="the disk is full"):
        fuse(*maps(given), **POSES, relative=T_R0_R1 @ SE2(1.0, 0.0, 0.0), refine="none", out=tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_an_interruption_never_leaves_a_record_beside_another_fusions_map(
    given: Path, tmp_path: Path, monkeypatch
):
    fuse(*maps(given), **POSES, relative=T_R0_R1, refine="none", out=tmp_path)
    moved, move = [], Disk.move

    def move_once(disk: Disk, name: str, new_name: str) -> None:
        if moved:
            raise KeyboardInterrupt
        moved.append(new_name)
        move(disk, name, new_name)

    monkeypatch.setattr(Disk, "move", move_once)
    with pytest.raises(KeyboardInterrupt):
        fuse(*maps(given), **POSES, relative=T_R0_R1 @ SE2(1.0, 0.0, 0.0), refine="none", out=tmp_path)
    assert moved == ["fused.pgm"]
    assert {path.name for path in tmp_path.iterdir()} == {"fused.pgm", "fused.yaml", "fused.png"}
