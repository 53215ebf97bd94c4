"""What a newcomer gets wrong with `fuse`: one line that says so, or a warning, and no more."""

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from rendezvous.cli.__main__ import app
from rendezvous.commands.fuse.from_python import fuse
from rendezvous.commands.fuse.inputs import read_camera
from rendezvous.errors import CameraError, ConfigError, MapError
from rendezvous.fusion.merge import merged
from rendezvous.geometry.occupancy_grid import FREE, OccupancyGrid
from rendezvous.geometry.se2 import SE2
from tests.baselines.windows import cuts
from tests.commands.fuse.test_fuse import POSES, Seeing, arguments, given, maps, option
from tests.conftest import ROOT
from tests.fusion.test_system import T_R0_R1
from tests.synthetic import CAMERA

__all__ = ["given"]  # a fixture

PICTURE = np.zeros((480, 640, 3), np.uint8)
SEEN = {"image": PICTURE, "camera": CAMERA, "relative": None}
RELATIVE = option("relative", *T_R0_R1.as_array())

WITHOUT_TORCH = """
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("torch", "safetensors", "tensorboard", "matplotlib"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Missing())
from rendezvous.cli.__main__ import main
main()
"""


def without_torch(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", WITHOUT_TORCH, *words], cwd=ROOT, capture_output=True, text=True
    )


def test_without_pytorch_it_fuses_by_correlative_search(given: Path, tmp_path: Path):
    done = without_torch(*arguments(given, RELATIVE, "--refine=correlative", "--out", str(tmp_path)))
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "result.json").is_file()


def test_without_pytorch_one_line_names_the_extra(given: Path, tmp_path: Path):
    done = without_torch(*arguments(given, RELATIVE, "--out", str(tmp_path)))
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "torch, which is not installed; `pip install 'rendezvous-fusion[fuse]'`" in done.stderr
    assert "correlative search, or not at all, does without" in done.stderr
    assert not list(tmp_path.iterdir())


def test_numbers_may_begin_with_a_minus_after_a_space(given: Path, tmp_path: Path):
    words = ["--pose0", "-1.0,2,0", "--relative", "-1,0,3", "--refine", "none", "--out", str(tmp_path)]
    shown = CliRunner().invoke(app, arguments(given, *words))
    assert shown.exit_code == 0, shown.output


@pytest.mark.parametrize("name", ["pose0", "pose1", "relative"])
def test_degrees_for_radians_are_suspected(given: Path, tmp_path: Path, name: str):
    words = arguments(given, RELATIVE, f"--{name}=0,0,90", "--refine=none", "--out", str(tmp_path))
    shown = CliRunner().invoke(app, words)
    assert shown.exit_code == 0, shown.output
    said = name.replace("pose", "pose ").replace("relative", "relative pose")
    assert shown.stderr.splitlines() == [
        f"rendezvous: {said}: an angle is 90 rad, more than a turn; radians are meant, and 90° are 1.5708 rad"
    ]


def test_python_is_told_of_degrees_too_and_a_turn_is_no_degrees(given: Path, recwarn):
    image = {"image": given / "image.png", "camera": given / "camera.yaml"}
    tilted = (0.0, 0.0, 0.1, 0.0, 30.0, 0.0)
    turn = SE2(T_R0_R1.x_m, T_R0_R1.y_m, 2.0 * math.pi)
    fuse(*maps(given), **POSES, relative=turn, refine="none")
    assert not recwarn.list
    with pytest.warns(UserWarning, match="camera pose: an angle is 30 rad") as told:
        fuse(
            *maps(given),
            **POSES,
            **image,
            camera_pose=tilted,
            refine="none",
            pose_estimator=Seeing(T_R0_R1),
        )
    assert told[0].filename == __file__


@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        (
            {"pose0": (1.0, 2.0)},
            ConfigError,
            r"pose0 is \(1\.0, 2\.0\); must be x \[m\], y \[m\], yaw \[rad\]",
        ),
        ({"pose1": (1.0, 2.0, 3.0, 4.0)}, ConfigError, "pose1 is .*; must be x"),
        ({"pose1": "1,2,abc"}, ConfigError, "pose1 is '1,2,abc'; must be x"),
        ({"pose1": None}, ConfigError, "pose1 is None; must be x"),
        ({"relative": np.eye(3)}, ConfigError, r"relative is array\(.*must be x"),
        ({"relative_sigma": (0.1, 0.1)}, ConfigError, r"relative_sigma is \(0\.1, 0\.1\); must be x"),
        (
            {"relative_sigma": (0.1, 1e200, 0.1)},
            ConfigError,
            "must be standard deviations above 0, at most 1000",
        ),
        (
            {"refine": "best"},
            ConfigError,
            "refine is 'best'; must be one of none, learned, correlative, auto",
        ),
        ({"out": 5}, ConfigError, "out is 5; must be a folder's name, or None"),
        ({"map1": np.zeros((9, 9))}, MapError, "a map is given as ndarray; must be its YAML file or"),
        (
            {"camera": np.eye(3), "image": "x.png", "relative": None},
            CameraError,
            "camera is given as ndarray",
        ),
        (
            {"map0": replace(cuts(0)[0], cells=np.full((9, 9), 100, np.uint8))},
            MapError,
            "81 cells of other values, as 100; must be 0 occupied, 205 unknown, 254 free",
        ),
        (
            {**SEEN, "image": np.zeros((480, 640, 4), np.uint8)},
            CameraError,
            r"shape \(480, 640, 4\), uint8; m",
        ),
        ({**SEEN, "image": np.zeros((480, 640), np.uint8)}, CameraError, r"shape \(480, 640\), uint8; must"),
        ({**SEEN, "image": np.zeros((480, 640, 3))}, CameraError, r"shape .*, float64; must be \(H, W, 3\)"),
        ({**SEEN, "image": object()}, CameraError, "image 0 is given as object; must be its file or"),
        ({**SEEN, "image": [PICTURE, b"bytes"]}, CameraError, "image 1 is given as bytes; must be its file"),
        (
            {**SEEN, "camera_pose": "0,0,0,0,0,0"},
            ConfigError,
            "camera_pose is '0,0,0,0,0,0'; must be x, y, z",
        ),
        ({**SEEN, "camera_pose": 0.3}, ConfigError, "camera_pose is 0.3; must be x, y, z"),
        ({**SEEN, "camera_pose": np.eye(4)}, ConfigError, r"camera_pose is array\(.*; must be x, y, z"),
        (
            {**SEEN, "relative_sigma": (0.1, 0.1, 0.1)},
            ConfigError,
            "relative_sigma: belongs to relative; an image gives its own",
        ),
        ({"camera": CAMERA}, ConfigError, "camera: belongs to image; relative needs no camera"),
        ({"camera_pose": [0.0] * 6}, ConfigError, "camera_pose: belongs to image"),
        ({"robot": Path("walker.yaml")}, ConfigError, "robot 'walker.yaml': no file walker.yaml"),
    ],
)
def test_a_wrong_argument_is_told_as_such(given: Path, change: dict, error: type[Exception], said: str):
    map_0, map_1 = maps(given)
    right = {"map0": map_0, "map1": map_1, **POSES, "relative": T_R0_R1, "refine": "none"}
    with pytest.raises(error, match=said):
        fuse(**(right | change))


@pytest.mark.parametrize(("fx_px", "fy_px", "said"), [(1e-9, 600.0, "fx is 1e-09"), (600.0, 1e300, "fy is")])
def test_a_camera_that_no_lens_makes_is_told(given: Path, fx_px: float, fy_px: float, said: str):
    camera = replace(CAMERA, fx_px=fx_px, fy_px=fy_px)
    with pytest.raises(
        CameraError, match=rf"camera: {said}.* px for an image of \d+ px; must be from \d+ to"
    ):
        fuse(*maps(given), **POSES, image=given / "image.png", camera=camera, pose_estimator=Seeing(T_R0_R1))


def test_an_image_that_no_decoder_takes_is_told_in_one_line(given: Path, tmp_path: Path, capfd):
    whole = cv2.imencode(".bmp", np.zeros((480, 640, 3), np.uint8))[1].tobytes()
    for name, data in (("cut.bmp", whole[:5000]), ("none.gif", b"GIF89a" + bytes(40))):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(CameraError, match=rf"{name}: \d+ bytes that are no image"):
            fuse(*maps(given), **POSES, image=tmp_path / name, camera=given / "camera.yaml")
    with pytest.raises(CameraError, match="/dev/zero: is no regular file; must be an image"):
        fuse(*maps(given), **POSES, image="/dev/zero", camera=given / "camera.yaml")
    assert capfd.readouterr().err == ""


@pytest.mark.filterwarnings("error")
def test_maps_that_no_number_spans_are_told_without_a_warning():
    cells = np.full((9, 9), FREE, np.uint8)
    near = OccupancyGrid(cells=cells, resolution_m=0.05, T_m_g=SE2.identity())
    with pytest.raises(MapError, match="are the poses, origins and resolutions right"):
        merged(near, near, SE2(1e300, 1e300, 0.0))


@pytest.mark.parametrize("share", [0.1, 20.0])
def test_focal_lengths_are_taken_up_to_those_of_real_lenses(share: float):
    camera = replace(CAMERA, fx_px=share * CAMERA.width_px, fy_px=share * CAMERA.height_px)
    assert read_camera(camera).camera == camera
