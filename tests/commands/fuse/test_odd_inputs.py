"""Numbers of numpy, pictures as phones save them, and names that are not UTF-8."""

import json
import os
import re
import shutil
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from rendezvous.cli.__main__ import app
from rendezvous.commands.fuse.from_python import fuse
from rendezvous.commands.fuse.inputs import read_photograph
from rendezvous.errors import PipelineError
from rendezvous.geometry.camera import PinholeCamera
from rendezvous.geometry.occupancy_grid import OccupancyGrid
from rendezvous.geometry.se2 import SE2
from rendezvous.interop.camera_info import CameraInfo
from rendezvous.pose_estimation.pose_estimate import PoseMode, RelativePose
from tests.baselines.windows import cuts
from tests.commands.fuse.test_fuse import POSES, T_C_O, Seeing, arguments, given, maps
from tests.conftest import ROOT
from tests.fusion.test_system import FINE, T_R0_R1
from tests.synthetic import CAMERA

__all__ = ["given"]  # a fixture

NOT_UTF8 = os.fsdecode(b"\xb5\xd8")
LENSLESS = CameraInfo(camera=CAMERA, distortion_model="plumb_bob", distortion=())


def only_plain_values(value: object) -> bool:
    if isinstance(value, dict):
        return all(map(only_plain_values, value.values()))
    return all(map(only_plain_values, value)) if isinstance(value, list) else type(value) in _PLAIN


_PLAIN = (str, int, float, bool, type(None))


@pytest.mark.parametrize("number", [np.float64, np.float32])
def test_numbers_of_numpy_are_written_so_that_any_loader_reads_them(given: Path, tmp_path: Path, number):
    grids = [
        OccupancyGrid(
            cells=grid.cells,
            resolution_m=number(grid.resolution_m),
            T_m_g=SE2(*(number(value) for value in grid.T_m_g.as_array())),
        )
        for grid in cuts(0)[:2]
    ]
    camera = PinholeCamera(
        **{name: number(getattr(CAMERA, name)) for name in ("fx_px", "fy_px", "cx_px", "cy_px")},
        width_px=np.int64(CAMERA.width_px),
        height_px=np.int32(CAMERA.height_px),
    )

    def seeing(image, camera, T_r0_c) -> RelativePose:
        mode = PoseMode(
            T_r0_r1=SE2(*(number(value) for value in T_R0_R1.as_array())),
            covariance=FINE.astype(number),
            mass=number(1.0),
            T_c_o=T_C_O,
            degrees_of_freedom=number(4.0),
        )
        return RelativePose(modes=(mode,), score=number(0.9), keypoints_px=np.zeros((9, 2)))

    fuse(
        *grids,
        **{name: T.as_array().astype(number) for name, T in POSES.items()},
        image=np.zeros((480, 640, 3), np.uint8),
        camera=camera,
        camera_pose=np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0], number),
        refine="correlative",
        out=tmp_path / "image",
        pose_estimator=seeing,
    )
    fuse(
        *grids,
        **POSES,
        relative=T_R0_R1.as_array().astype(number),
        relative_sigma=np.array([0.1, 0.1, 0.05], number),
        refine="none",
        out=tmp_path / "relative",
    )
    for folder in (tmp_path / "image", tmp_path / "relative"):
        fields = yaml.safe_load((folder / "fused.yaml").read_text())
        assert fields["resolution"] == pytest.approx(0.05)
        record = json.loads((folder / "result.json").read_text())
        assert only_plain_values(fields)
        assert only_plain_values(record)
    assert record["inputs"]["relative_sigma"] == pytest.approx([0.1, 0.1, 0.05])


def picture() -> np.ndarray:
    """(480, 640, 3) uint8 RGB with another grey in each corner, so that a turn shows."""
    image = np.zeros((480, 640, 3), np.uint8)
    image[:240, :320], image[:240, 320:], image[240:, :320] = 60, 120, 180
    return image


def with_orientation(data: bytes, orientation: int) -> bytes:
    """A JPEG with an EXIF segment of that one tag."""
    tiff = b"II*\0" + struct.pack("<IHHHIHHI", 8, 1, 0x0112, 3, 1, orientation, 0, 0)
    segment = b"Exif\0\0" + tiff
    return data[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + data[2:]


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_picture_is_read_as_it_is_stored_and_its_orientation_told(
    tmp_path: Path, orientation: int, recwarn
):
    whole = cv2.imencode(".jpg", picture(), [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    (tmp_path / "photo.jpg").write_bytes(with_orientation(whole, orientation))
    shot = read_photograph(tmp_path / "photo.jpg", LENSLESS, number=0)
    assert np.abs(shot.image.astype(int) - picture()).mean() < 2.0
    said = [str(warning.message) for warning in recwarn]
    assert len(said) == (orientation != 1)
    assert all("has an EXIF orientation" in text and "it is read as it is stored" in text for text in said)


def tiff(pixels: np.ndarray, orientation: int, order: str) -> bytes:
    """An uncompressed TIFF of (H, W, 3) uint8 in one strip."""
    height, width = pixels.shape[:2]
    tags = {256: width, 257: height, 258: 8, 259: 1, 262: 2, 273: 8, 274: orientation, 277: 3, 278: height}
    entries = [struct.pack(f"{order}HHII", tag, 4, 1, value) for tag, value in tags.items()]
    entries[6] = struct.pack(f"{order}HHIHH", 274, 3, 1, orientation, 0)
    entries.append(struct.pack(f"{order}HHII", 279, 4, 1, pixels.size))
    start = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}I", 8 + pixels.size)
    return start + pixels.tobytes() + struct.pack(f"{order}H", len(entries)) + b"".join(entries) + bytes(4)


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_tiff_is_read_as_it_is_stored(tmp_path: Path, orientation: int, order: str, recwarn):
    (tmp_path / "photo.tif").write_bytes(tiff(picture(), orientation, order))
    shot = read_photograph(tmp_path / "photo.tif", LENSLESS, number=0)
    np.testing.assert_array_equal(shot.image, picture())
    assert len(recwarn.list) == (orientation != 1)


def test_a_pose_of_any_kind_of_number_is_fused_or_named():
    cells = np.full((20, 20), 254, np.uint8)
    numbers = [np.longdouble(value) for value in (0.5, 0.5, 0.0)]
    grid = OccupancyGrid(cells=cells, resolution_m=0.1, T_m_g=SE2(*map(np.float16, numbers)))
    poses = {"pose0": SE2(*numbers), "pose1": SE2(*numbers)}
    assert fuse(grid, grid, **poses, relative=SE2(*numbers), refine="none").grid.resolution_m == 0.1
    with pytest.raises(PipelineError, match=r"relative is \(10+.*must be x \[m\], y \[m\], yaw \[rad\]"):
        fuse(grid, grid, **poses, relative=(10**400, 0, 0), refine="none")


def test_a_motion_photo_is_read(tmp_path: Path, recwarn):
    whole = cv2.imencode(".jpg", picture())[1].tobytes()
    for name, more in (("padded.jpg", bytes(4096)), ("motion.jpg", b"\0\0\0\x18ftypmp42" + whole * 3)):
        (tmp_path / name).write_bytes(whole + more)
        assert read_photograph(tmp_path / name, LENSLESS, number=0).image.shape == (480, 640, 3)
    assert not recwarn.list


def refusal(*words: str) -> str:
    """The one line of a command that refuses."""
    shown = CliRunner().invoke(app, list(words))
    assert shown.exit_code == 2, shown.output
    assert shown.stdout == ""
    assert shown.stderr.count("\n") == 1
    return shown.stderr


def test_files_with_names_that_are_not_utf8_are_fused(given: Path, tmp_path: Path):
    folder = tmp_path / NOT_UTF8
    shutil.copytree(given, folder)
    picture = {"image": folder / "image.png", "camera": folder / "camera.yaml"}
    fuse(*maps(folder), **POSES, **picture, refine="none", pose_estimator=Seeing(T_R0_R1), out=tmp_path)
    record = json.loads((tmp_path / "result.json").read_text())
    assert [Path(name) for name in record["inputs"]["maps"]] == list(maps(folder))


@pytest.mark.parametrize(
    ("option_name", "said"),
    [
        ("--map0", "cannot be read as YAML"),
        ("--camera", "cannot be read as YAML"),
        ("--image", "no such file or directory; must be an image"),
        ("--robot", "robot "),
        ("--out", "is not UTF-8; must name a folder in it"),
    ],
)
def test_a_name_that_is_not_utf8_is_one_line(given: Path, tmp_path: Path, option_name: str, said: str):
    words = arguments(given, "--image", str(given / "image.png"), "--camera", str(given / "camera.yaml"))
    words += ["--out", str(tmp_path), "--refine=none", option_name, str(tmp_path / NOT_UTF8)]
    if option_name == "--image":
        del words[words.index("--image") : words.index("--image") + 2]
    assert said in refusal(*words)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["\ud800", "a\0b", "a\udcffb"])
@pytest.mark.parametrize("argument", ["map1", "image", "camera", "robot", "out"])
def test_python_is_told_of_names_that_no_file_can_have(given: Path, name: str, argument: str):
    map_0, map_1 = maps(given)
    right = {"map0": map_0, "map1": map_1, "image": given / "image.png", "camera": given / "camera.yaml"}
    with pytest.raises(PipelineError):
        fuse(**POSES, **(right | {argument: name}), refine="none", pose_estimator=Seeing(T_R0_R1))


def test_a_data_folder_that_is_not_utf8_is_one_line(tmp_path: Path):
    for words in (["floorplans", "--preset", "smoke", "--data"], ["evaluate", "--data"], ["verify"]):
        assert "is not UTF-8" in refusal(*words, str(tmp_path / NOT_UTF8))


def test_images_are_decoded_from_memory_everywhere():
    """OpenCV fails, or crashes, on names that are not UTF-8."""
    named = re.compile(r"imread|imwrite|VideoCapture")
    sources = list((ROOT / "pipeline").rglob("*.py"))
    assert len(sources) > 100
    assert [path for path in sources if named.search(path.read_text())] == []
