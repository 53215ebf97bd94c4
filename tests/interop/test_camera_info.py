from __future__ import annotations

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from rendezvous.errors import CameraError
from rendezvous.geometry.camera import PinholeCamera
from rendezvous.interop.camera_info import CameraInfo, camera_info_bytes, read_camera_info, write_camera_info

CAMERA = PinholeCamera(fx_px=410.0, fy_px=405.0, cx_px=322.5, cy_px=236.0, width_px=640, height_px=480)
LENSES = {
    "plumb_bob": (-0.28, 0.09, 0.001, -0.0006, -0.012),
    "rational_polynomial": (0.6, -2.4, 0.0004, -0.0003, 1.4, 0.47, -2.2, 1.35),
    "equidistant": (-0.02, 0.012, -0.006, 0.001),
}

CALIBRATION = """\
image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [410., 0., 322.5, 0., 405., 236., 0., 0., 1.]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.28, 0.09, 1e-3, -6.0e-4, -0.012]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]
"""

MESSAGE = """\
header:
  stamp:
    sec: 12
    nanosec: 5
  frame_id: camera_color_optical_frame
height: 480
width: 640
distortion_model: plumb_bob
d:
- -0.28
- 0.09
- 0.001
- -0.0006
- -0.012
k: [410.0, 0.0, 322.5, 0.0, 405.0, 236.0, 0.0, 0.0, 1.0]
r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
p: [410.0, 0.0, 322.5, 0.0, 0.0, 405.0, 236.0, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
binning_y: 0
roi:
  x_offset: 0
  y_offset: 0
  height: 0
  width: 0
  do_rectify: false
---
"""


def _file(tmp_path, text: str):
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    "text",
    [
        CALIBRATION,
        MESSAGE,
        MESSAGE + MESSAGE,
        MESSAGE.replace("\nd:", "\nD:").replace("\nk:", "\nK:"),
        MESSAGE.replace("  height: 0\n  width: 0", "  height: 480\n  width: 640"),
    ],
)
def test_both_forms_of_a_calibration_give_the_same_camera(tmp_path, text):
    info = read_camera_info(_file(tmp_path, text))
    expected = CameraInfo(camera=CAMERA, distortion_model="plumb_bob", distortion=LENSES["plumb_bob"])
    assert info == expected


def test_a_lens_without_coefficients_bends_nothing(tmp_path):
    text = CALIBRATION.replace("[-0.28, 0.09, 1e-3, -6.0e-4, -0.012]", "[]").replace("plumb_bob", "''")
    info = read_camera_info(_file(tmp_path, text))
    image = np.random.default_rng(0).integers(0, 256, (480, 640, 3), np.uint8)
    assert np.array_equal(info.undistorted(image), image)


@given(
    st.builds(
        PinholeCamera,
        fx_px=st.floats(1e-3, 1e5),
        fy_px=st.floats(1e-3, 1e5),
        cx_px=st.floats(-1e4, 1e4),
        cy_px=st.floats(-1e4, 1e4),
        width_px=st.integers(1, 10_000),
        height_px=st.integers(1, 10_000),
    )
)
def test_any_camera_comes_back_as_it_was_written(tmp_path_factory, camera):
    path = tmp_path_factory.mktemp("camera") / "camera.yaml"
    write_camera_info(camera, path)
    info = read_camera_info(path)
    assert info.camera == camera
    assert not any(info.distortion)


def test_what_is_written_has_what_ros_asks_for(tmp_path):
    write_camera_info(CAMERA, tmp_path / "burger.yaml")
    fields = yaml.safe_load((tmp_path / "burger.yaml").read_text())
    assert fields["camera_name"] == "burger"
    for key, shape in {
        "camera_matrix": (3, 3),
        "distortion_coefficients": (1, 5),
        "rectification_matrix": (3, 3),
        "projection_matrix": (3, 4),
    }.items():
        assert (fields[key]["rows"], fields[key]["cols"]) == shape
        assert len(fields[key]["data"]) == shape[0] * shape[1]


def _points_c() -> np.ndarray:
    """(N, 3) [m] a lattice of points 2 m ahead of the camera."""
    x_m, y_m = np.meshgrid(np.linspace(-1.0, 1.0, 9), np.linspace(-0.7, 0.7, 7))
    return np.column_stack([x_m.ravel(), y_m.ravel(), np.full(x_m.size, 2.0)])


def _seen_through(lens: str, points_c: np.ndarray) -> np.ndarray:
    """(N, 2) [px] where OpenCV says that a lens shows the points."""
    coefficients, K, zero = np.array(LENSES[lens]), CAMERA.K(), np.zeros(3)
    if lens == "equidistant":
        uv_px, _ = cv2.fisheye.projectPoints(points_c[None], zero, zero, K, coefficients)
    else:
        uv_px, _ = cv2.projectPoints(points_c, zero, zero, K, coefficients)
    return uv_px.reshape(-1, 2)


def _dots(uv_px: np.ndarray) -> np.ndarray:
    """(480, 640) uint8: a soft dot at every place."""
    image = np.zeros((480, 640), np.uint8)
    dv, du = np.mgrid[-10:11, -10:11]
    for u, v in uv_px:
        cols, rows = du + round(u), dv + round(v)
        dot = 255 * np.exp(-0.5 * ((cols - u) ** 2 + (rows - v) ** 2) / 2.0**2)
        image[rows, cols] = np.maximum(image[rows, cols], dot.astype(np.uint8))
    return image


def _found_near(image: np.ndarray, uv_px: np.ndarray) -> np.ndarray:
    """(N, 2) [px] centre of brightness within 8 px of every place."""
    centres = []
    for u, v in np.round(uv_px).astype(int):
        patch = image[v - 8 : v + 9, u - 8 : u + 9].astype(float)
        dv, du = np.mgrid[-8:9, -8:9]
        centres.append([u + (patch * du).sum() / patch.sum(), v + (patch * dv).sum() / patch.sum()])
    return np.array(centres)


@pytest.mark.parametrize("lens", LENSES)
def test_an_undistorted_image_has_points_where_the_pinhole_camera_has_them(lens):
    points_c = _points_c()
    bent_px, straight_px = _seen_through(lens, points_c), CAMERA.project(points_c)
    assert np.linalg.norm(bent_px - straight_px, axis=1).max() > 4.0
    info = CameraInfo(camera=CAMERA, distortion_model=lens, distortion=LENSES[lens])
    image = info.undistorted(_dots(bent_px))
    assert _found_near(image, straight_px) == pytest.approx(straight_px, abs=0.3)


@pytest.mark.parametrize("lens", LENSES)
def test_a_coloured_image_is_undistorted_channel_by_channel(lens):
    info = CameraInfo(camera=CAMERA, distortion_model=lens, distortion=LENSES[lens])
    image = np.random.default_rng(0).integers(0, 256, (480, 640, 3), np.uint8)
    each = [info.undistorted(np.ascontiguousarray(image[..., channel])) for channel in range(3)]
    assert np.array_equal(info.undistorted(image), np.dstack(each))


def test_a_fisheye_lens_bends_the_image_also_where_its_coefficients_are_0():
    image = np.random.default_rng(0).integers(0, 256, (480, 640, 3), np.uint8)
    info = CameraInfo(camera=CAMERA, distortion_model="equidistant", distortion=(0.0,) * 4)
    K = CAMERA.K()
    expected = cv2.fisheye.undistortImage(image, K, np.zeros(4), Knew=K)
    assert np.array_equal(info.undistorted(image), expected)
    assert not np.array_equal(expected, image)


def _lens(model: str, coefficients) -> str:
    return CALIBRATION.replace("plumb_bob", model).replace(
        "[-0.28, 0.09, 1e-3, -6.0e-4, -0.012]", str(list(coefficients))
    )


@pytest.mark.parametrize("count", [5, 8, 12, 14])
@pytest.mark.parametrize("lens", LENSES)
def test_coefficients_that_are_padded_with_zeros_are_those_without(tmp_path, lens, count):
    if count >= len(LENSES[lens]):
        given = (*LENSES[lens], *[0.0] * (count - len(LENSES[lens])))
        read = read_camera_info(_file(tmp_path, _lens(lens, given))).distortion
        assert read[: len(LENSES[lens])] == LENSES[lens]
        assert not any(read[len(LENSES[lens]) :])
        assert lens == "rational_polynomial" or len(read) == len(LENSES[lens])


@pytest.mark.parametrize("count", [4, 5, 8, 12, 14])
def test_the_rational_model_has_as_many_coefficients_as_opencv_takes(tmp_path, count):
    given = tuple(0.01 / (1 + i) for i in range(count))
    info = read_camera_info(_file(tmp_path, _lens("Rational_Polynomial", given)))
    assert (info.distortion_model, info.distortion) == ("rational_polynomial", given)
    image = np.random.default_rng(0).integers(0, 256, (480, 640), np.uint8)
    assert np.array_equal(info.undistorted(image), cv2.undistort(image, CAMERA.K(), np.array(given)))


@pytest.mark.parametrize(
    ("model", "given", "said"),
    [
        ("plumb_bob", [0.1] * 8, "plumb_bob has 8 coefficients; must be 4 or 5, or none"),
        ("plumb_bob", [0.1] * 3, "plumb_bob has 3 coefficients; must be 4 or 5, or none"),
        ("equidistant", [0.1] * 5, "equidistant has 5 coefficients; must be 4, or none"),
        ("fisheye", [0.1] * 4 + [0.0, 0.0, 0.0, 0.1], "fisheye has 8 coefficients; must be 4, or none"),
        (
            "rational_polynomial",
            [0.1] * 6,
            "rational_polynomial has 6 coefficients; must be 4 or 5 or 8 or 12 or 14, or none",
        ),
    ],
)
def test_a_model_with_another_count_of_coefficients_is_refused(tmp_path, model, given, said):
    with pytest.raises(CameraError, match=said):
        read_camera_info(_file(tmp_path, _lens(model, given)))


@pytest.mark.parametrize(
    "roi", ["{x_offset: 0, y_offset: 0, height: 480, width: 640, do_rectify: false}", "null", "{}"]
)
def test_a_region_that_is_the_whole_image_is_none(tmp_path, roi):
    text = f"{CALIBRATION}roi: {roi}\nbinning_x: 1\nbinning_y: '0'\n"
    assert read_camera_info(_file(tmp_path, text)).camera == CAMERA


def test_a_camera_of_numpy_numbers_is_written(tmp_path):
    numbers = dict(zip(("fx_px", "fy_px", "cx_px", "cy_px"), np.float32([410, 405, 322.5, 236]), strict=True))
    camera = PinholeCamera(**numbers, width_px=np.int64(640), height_px=np.int32(480))
    write_camera_info(camera, tmp_path / "camera.yaml")
    assert read_camera_info(tmp_path / "camera.yaml").camera == CAMERA


def test_an_image_of_another_size_is_refused():
    info = CameraInfo(camera=CAMERA, distortion_model="plumb_bob", distortion=())
    with pytest.raises(
        CameraError, match="image of 1280 x 720 px; the camera is calibrated for 640 x 480 px"
    ):
        info.undistorted(np.zeros((720, 1280, 3), np.uint8))


@pytest.mark.parametrize(
    ("text", "old", "new", "message"),
    [
        (
            CALIBRATION,
            "image_width: 640\n",
            "",
            "no key 'image_width' or 'width'; must be a camera calibration",
        ),
        (
            CALIBRATION,
            "image_height: 480",
            "image_height: 0",
            "image_height is 0; must be a whole number of pix",
        ),
        (
            CALIBRATION,
            "image_height: 480",
            "image_height: 4.5",
            r"image_height is 4\.5; must be a whole number",
        ),
        (CALIBRATION, "236., 0., 0., 1.]", "236.]", "the camera matrix has 6 numbers; must be 9"),
        (
            CALIBRATION,
            "[410.,",
            "[0.,",
            r"the camera matrix is \[0.*; must be \[fx, 0, cx, 0, fy, cy, 0, 0, 1\]",
        ),
        (CALIBRATION, "405., 236.", "0., 236.", r"the camera matrix is \[410.*; must be \[fx, 0, cx"),
        (
            CALIBRATION,
            "data: [410., 0., 322.5, 0., 405., 236., 0., 0., 1.]",
            "data: [0., 0., 0., 0., 0., 0., 0., 0., 0.]",
            "the camera matrix is all 0, .* not calibrated; calibrate it",
        ),
        (CALIBRATION, "[410., 0.", "[410., 0.2", r"the camera matrix is \[410.*; must be \[fx, 0, cx"),
        (CALIBRATION, "[410.,", "[.nan,", "camera_matrix is .*; must be a list of numbers"),
        (CALIBRATION, "  data: [410.", "  numbers: [410.", "camera_matrix is .*; must be a list of numbers"),
        (
            CALIBRATION,
            "plumb_bob",
            "thin_prism",
            "distortion_model is 'thin_prism'; must be one of plumb_bob",
        ),
        (CALIBRATION, "plumb_bob", "[a]", r"distortion_model is \['a'\]; must be one of plumb_bob"),
        (CALIBRATION, "-0.012]", "-0.012, 0]", "plumb_bob has 6 coefficients; must be 4 or 5, or none"),
        (
            CALIBRATION,
            "distortion_coefficients",
            "distortion",
            "no key 'distortion_coefficients' or 'd' or 'D'",
        ),
        (CALIBRATION, CALIBRATION, "", "holds no keys; must be a camera calibration of ROS"),
        (CALIBRATION, "data: [1.", "data: ]1.", "cannot be read as YAML"),
        (MESSAGE, "binning_x: 0", "binning_x: 2", "binning_x is 2; must be 0 or 1, an image not binned"),
        (MESSAGE, "  width: 0", "  width: 320", r"roi is x, y, width, height \[0, 0, 320, 0\]; must be 0"),
        (MESSAGE, "x_offset: 0", "x_offset: 8", r"roi is x, y, width, height \[8, 0, 0, 0\]; must be 0"),
    ],
)
def test_a_faulty_calibration_is_named_with_its_fault(tmp_path, text, old, new, message):
    assert old in text
    with pytest.raises(CameraError, match=rf"\A[^\n]*camera\.yaml: {message}[^\n]*\Z"):
        read_camera_info(_file(tmp_path, text.replace(old, new, 1)))


def test_a_missing_calibration_is_named(tmp_path):
    with pytest.raises(CameraError, match=r"nowhere\.yaml: cannot be read as YAML \(.*No such file"):
        read_camera_info(tmp_path / "nowhere.yaml")


@pytest.mark.parametrize(
    "model", ["None", "none", "pinhole", "Inverse Brown Conrady", "plumb bob", "plumb-bob "]
)
@pytest.mark.parametrize("count", [0, 1, 5, 6])
def test_coefficients_of_zero_bend_nothing_under_any_name(tmp_path, model, count):
    info = read_camera_info(_file(tmp_path, _lens(f"'{model}'", [0.0] * count)))
    assert info.distortion_model == "plumb_bob"
    assert not any(info.distortion)


@pytest.mark.parametrize("model", ["none", "radtan", "kannala_brandt"])
def test_coefficients_of_another_model_are_refused(tmp_path, model):
    with pytest.raises(CameraError, match=f"distortion_model is '{model}'; must be one of plumb_bob"):
        read_camera_info(_file(tmp_path, _lens(model, [0.1] * 5)))


def test_the_file_of_a_camera_is_that_of_ros_for_images_that_are_rectified():
    camera = PinholeCamera(fx_px=610.0, fy_px=620.0, cx_px=300.0, cy_px=250.0, width_px=640, height_px=480)
    K = [610.0, 0.0, 300.0, 0.0, 620.0, 250.0, 0.0, 0.0, 1.0]
    assert yaml.safe_load(camera_info_bytes(camera, "front")) == {
        "image_width": 640,
        "image_height": 480,
        "camera_name": "front",
        "camera_matrix": {"rows": 3, "cols": 3, "data": K},
        "distortion_model": "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.0] * 5},
        "rectification_matrix": {"rows": 3, "cols": 3, "data": [1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0]},
        "projection_matrix": {
            "rows": 3,
            "cols": 4,
            "data": [610.0, 0.0, 300.0, 0.0, 0.0, 620.0, 250.0, 0.0, 0.0, 0.0, 1.0, 0.0],
        },
    }
