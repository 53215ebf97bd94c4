"""`fuse` on files: what it reads, refuses and writes, from Python and from the command line."""

import json
import math
import subprocess
import sys
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from rendezvous.alignment.frame_error import frame_error
from rendezvous.cli.__main__ import app
from rendezvous.commands.fuse.arguments import MERGINGS, REFINEMENTS
from rendezvous.commands.fuse.from_python import fuse
from rendezvous.commands.fuse.outputs import summary
from rendezvous.errors import CameraError, ConfigError, MapError, PipelineError, SightingError
from rendezvous.fusion.merge import Merging, probabilistically_merged
from rendezvous.fusion.refinement import Refinement
from rendezvous.geometry.camera import camera_pose
from rendezvous.geometry.cuboid import project_cuboid
from rendezvous.geometry.occupancy_grid import UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2
from rendezvous.interop.camera_info import read_camera_info, write_camera_info
from rendezvous.interop.ros_map import read_ros_map, write_ros_map
from rendezvous.pose_estimation.pose_estimate import PoseMode, RelativePose
from rendezvous.robot_file import ROBOTS
from tests.baselines.windows import REAL_T_M0_M1, cuts, real_maps
from tests.conftest import ROOT
from tests.fusion.test_system import FINE, T_R0_R1, meeting
from tests.synthetic import CAMERA

T_C_O = np.array([[0.0, -1.0, 0.0, 0.1], [0.0, 0.0, -1.0, 0.05], [1.0, 0.0, 0.0, 1.4], [0.0, 0.0, 0.0, 1.0]])


class Seeing:
    """An estimator that answers this, and keeps what it is given."""

    def __init__(self, *T_r0_r1: SE2) -> None:
        self.answers = list(T_r0_r1)
        self.given: list[tuple] = []

    def __call__(self, image, camera, T_r0_c) -> RelativePose:
        self.given.append((image, camera, T_r0_c))
        if not self.answers:
            return RelativePose.not_found("too dark")
        mode = PoseMode(T_r0_r1=self.answers.pop(0), covariance=FINE, mass=1.0, T_c_o=T_C_O)
        return RelativePose(modes=(mode,), score=0.9, keypoints_px=np.zeros((9, 2)))


@pytest.fixture(scope="module")
def given(tmp_path_factory) -> Path:
    """Two maps, an image and its camera."""
    folder = tmp_path_factory.mktemp("given")
    for number, grid in enumerate(cuts(0)[:2]):
        write_ros_map(grid, folder / f"map{number}.yaml")
    write_camera_info(CAMERA, folder / "camera.yaml")
    image = np.random.default_rng(0).integers(0, 255, (480, 640, 3), np.uint8)
    cv2.imwrite(str(folder / "image.png"), image)
    return folder


POSES = {"pose0": meeting().T_m0_r0, "pose1": meeting().T_m1_r1}


def maps(folder: Path) -> tuple[Path, Path]:
    return folder / "map0.yaml", folder / "map1.yaml"


def off(T_m0_m1: SE2) -> float:
    """How far it puts robot 1 from where it stood [m]."""
    left = frame_error(T_m0_m1, cuts(0)[2], cuts(0)[2] @ meeting().T_m1_r1)
    return math.hypot(left.x_m, left.y_m)


def option(name: str, *values: float) -> str:
    return f"--{name}={','.join(map(str, values))}"


def arguments(folder: Path, *more: str) -> list[str]:
    poses = [option(name, *T.as_array()) for name, T in POSES.items()]
    map_0, map_1 = maps(folder)
    return ["fuse", "--map0", str(map_0), "--map1", str(map_1), *poses, *more]


def test_files_and_arrays_give_the_same(given: Path):
    from_files = fuse(*maps(given), **POSES, relative=T_R0_R1, refine="none")
    grids = cuts(0)[:2]
    from_arrays = fuse(
        *grids,
        **{k: T.as_array() for k, T in POSES.items()},
        relative=tuple(T_R0_R1.as_array()),
        refine="none",
    )
    assert from_files.T_m0_m1 == from_arrays.T_m0_m1
    np.testing.assert_array_equal(from_files.grid.cells, from_arrays.grid.cells)


def test_the_caller_keeps_its_threads(given: Path):
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(3)
        fuse(*maps(given), **POSES, relative=T_R0_R1, refine="learned")
        assert torch.get_num_threads() == 3
        with pytest.raises(PipelineError):
            fuse(*maps(given), **POSES, image=given / "camera.yaml", camera=CAMERA)
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(before)


def test_what_it_writes_can_be_read(given: Path, tmp_path: Path):
    started_s = perf_counter()
    result = fuse(
        *maps(given),
        **POSES,
        image=given / "image.png",
        camera=given / "camera.yaml",
        refine="correlative",
        out=tmp_path,
        pose_estimator=Seeing(T_R0_R1 @ SE2(0.03, -0.02, 0.03)),
    )
    assert off(result.T_m0_m1) < 0.1
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"fused.pgm", "fused.yaml", "fused.png", "image.png", "result.json"}
    grid = read_ros_map(tmp_path / "fused.yaml", strict=True)
    np.testing.assert_array_equal(grid.cells, result.grid.cells)
    assert grid.T_m_g == result.grid.T_m_g
    told = json.loads((tmp_path / "result.json").read_text())
    assert told["verdict"] == "accepted"
    forth, back = (SE2(**told[key]) for key in ("T_m0_m1", "T_m1_m0"))
    assert forth.as_array() == pytest.approx(result.T_m0_m1.as_array())
    assert (forth @ back).wrapped().as_array() == pytest.approx(np.zeros(3), abs=1e-9)
    assert told["frame_error"]["covariance"] == pytest.approx(result.covariance)
    assert set(told["seconds"]) == {"read", "load", "see", "refine", "merge", "check"}
    assert told["inputs"]["images"] == [str(given / "image.png")]
    assert (told["overlap"], told["reasons"]) == (result.overlap, [])
    assert result.before.wall_share < result.after.wall_share
    for told_of, agreement in (("agreement_before", result.before), ("agreement_after", result.after)):
        assert told[told_of] == {
            "compared_m": agreement.compared_m,
            "wall_share": agreement.wall_share,
            "conflict_share": agreement.conflict_share,
        }
    said = summary(result, tmp_path).splitlines()
    before, after = (f"{100.0 * found.wall_share:.0f}%" for found in (result.before, result.after))
    assert said[0] == "accepted"
    assert said[2].endswith(f"that coincide: {before} by the sighting alone, {after} now")
    seconds = [float(word) for word in said[3].replace(",", "").split()[2::2]]
    assert seconds == pytest.approx(list(told["seconds"].values()), abs=0.006)
    assert 0.0 < sum(seconds) < perf_counter() - started_s


def test_the_cuboid_is_drawn_where_the_pose_has_it(given: Path, tmp_path: Path):
    fuse(
        *maps(given),
        **POSES,
        image=np.zeros((480, 640, 3), np.uint8),
        camera=CAMERA,
        refine="none",
        out=tmp_path,
        pose_estimator=Seeing(T_R0_R1),
    )
    drawn = cv2.imread(str(tmp_path / "image.png"))[:480].any(axis=2)
    uv_px = project_cuboid(T_C_O, (0.138, 0.178, 0.192), CAMERA)
    rows, cols = np.nonzero(drawn)
    assert (cols.min(), rows.min()) == pytest.approx(uv_px.min(axis=0), abs=2.0)
    assert (cols.max(), rows.max()) == pytest.approx(uv_px.max(axis=0), abs=2.0)


def test_several_images_are_combined_and_each_is_drawn(given: Path, tmp_path: Path):
    seeing = Seeing(T_R0_R1, T_R0_R1, T_R0_R1 @ SE2(2.0, 0.0, 0.0))
    result = fuse(
        *maps(given),
        **POSES,
        image=[given / "image.png"] * 4,
        camera=given / "camera.yaml",
        refine="none",
        out=tmp_path,
        pose_estimator=seeing,
    )
    assert result.sighting.found_in == (0, 1, 2)
    assert result.sighting.contradicted_by == (2,)
    assert result.sighting.best.covariance == pytest.approx(FINE / 2.0)
    told = json.loads((tmp_path / "result.json").read_text())
    assert [(mode["mass"], mode["images"]) for mode in told["sighting"]] == [
        (mode.mass, list(mode.images)) for mode in result.sighting.modes
    ]
    assert [image["found"] for image in told["images"]] == [True, True, True, False]
    assert [image["reason"] for image in told["images"]] == ["", "", "", "too dark"]
    assert len(list(tmp_path.glob("image_?.png"))) == 4
    fuse(*maps(given), **POSES, relative=T_R0_R1, refine="none", out=tmp_path)
    assert not list(tmp_path.glob("image*.png")), "pictures of another fusion must not stay"


def test_the_estimator_sees_an_undistorted_image_in_rgb_and_where_the_camera_is(given: Path, tmp_path: Path):
    text = (
        (given / "camera.yaml").read_text().replace("[0.0, 0.0, 0.0, 0.0, 0.0]", "[-0.3, 0.1, 0.0, 0.0, 0.0]")
    )
    (tmp_path / "bent.yaml").write_text(text)
    info = read_camera_info(tmp_path / "bent.yaml")
    assert info.distortion[0] == -0.3
    seeing = Seeing(T_R0_R1)
    mounted = (0.05, 0.01, 0.3, 0.0, 0.1, -0.2)
    fuse(
        *maps(given),
        **POSES,
        image=given / "image.png",
        camera=tmp_path / "bent.yaml",
        camera_pose=mounted,
        refine="none",
        pose_estimator=seeing,
    )
    ((image, camera, T_r0_c),) = seeing.given
    rgb = cv2.imread(str(given / "image.png"))[..., ::-1]
    np.testing.assert_array_equal(image, info.undistorted(np.ascontiguousarray(rgb)))
    assert camera == CAMERA
    np.testing.assert_array_equal(T_r0_c, camera_pose(np.array(mounted[:3]), np.array(mounted[3:])))


def test_by_default_the_camera_is_where_the_robot_has_it(given: Path):
    seeing = Seeing(T_R0_R1)
    image, camera = given / "image.png", given / "camera.yaml"
    fuse(*maps(given), **POSES, image=image, camera=camera, refine="none", pose_estimator=seeing)
    np.testing.assert_allclose(seeing.given[0][2][:3, 3], [0.034, 0.0, 0.120])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "0 bytes that are no image"),
        (b"not an image at all", "19 bytes that are no image"),
        ("half.png", "the image is damaged, or cut short after"),
        ("half.jpg", "the image is damaged, or cut short after"),
        ("small", "image of 320 x 240 px; the camera is calibrated for 640 x 480 px"),
        (None, "no such file or directory; must be an image"),
    ],
)
def test_a_bad_image_is_told(given: Path, tmp_path: Path, content, said: str):
    path = tmp_path / "bad.png"
    if content in ("half.png", "half.jpg"):
        whole = cv2.imencode(content[4:], cv2.imread(str(given / "image.png")))[1].tobytes()
        path.write_bytes(whole[: len(whole) // 2])
    elif content == "small":
        cv2.imwrite(str(path), np.zeros((240, 320, 3), np.uint8))
    elif content is not None:
        path.write_bytes(content)
    with pytest.raises(CameraError, match=said) as caught:
        fuse(*maps(given), **POSES, image=path, camera=given / "camera.yaml", pose_estimator=Seeing(T_R0_R1))
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("given_words", "words", "said"),
    [
        (
            "size_m: [0.138, 0.178, 0.192]",
            "size_m: [0.138, 0.178, 0.4]",
            r"0.178 x 0.4 m around \(-0.032, 0,",
        ),
        ("centre_m: [-0.032, 0.0, 0.096]", "centre_m: [0.032, 0.0, 0.096]", r"0.192 m around \(0.032, 0,"),
    ],
)
def test_weights_of_another_robot_are_told(given: Path, tmp_path: Path, given_words, words, said):
    robot = tmp_path / "other.yaml"
    text = (ROBOTS / "burger" / "robot.yaml").read_text()
    assert given_words in text
    robot.write_text(text.replace(given_words, words))
    said = (
        rf"'burger', whose cuboid is 0.138 x 0.178 x 0.192 m around \(-0.032, 0, .*; that of .* is .*{said}"
    )
    with pytest.raises(ConfigError, match=said):
        fuse(*maps(given), **POSES, image=given / "image.png", camera=given / "camera.yaml", robot=str(robot))


def test_what_does_not_fit_together_is_told(given: Path):
    both = {"image": given / "image.png", "camera": given / "camera.yaml", "relative": T_R0_R1}
    with pytest.raises(ConfigError, match="and not both"):
        fuse(*maps(given), **POSES, **both)
    with pytest.raises(ConfigError, match="needs the camera"):
        fuse(*maps(given), **POSES, image=given / "image.png")
    with pytest.raises(ConfigError, match="standard deviations above 0"):
        fuse(*maps(given), **POSES, relative=T_R0_R1, relative_sigma=(0.1, -0.1, 0.1))
    with pytest.raises(ConfigError, match=r"camera_pose is .*must be x, y, z"):
        fuse(*maps(given), **POSES, image=given / "image.png", camera=CAMERA, camera_pose=(1.0, 2.0))
    with pytest.raises(ConfigError, match="merge is 'best'; must be one of occupied, probabilistic"):
        fuse(*maps(given), **POSES, relative=T_R0_R1, merge="best")
    with pytest.raises(PipelineError, match="is not finite"):
        fuse(*maps(given), pose0=(math.nan, 0.0, 0.0), pose1=POSES["pose1"], relative=T_R0_R1)


def test_a_robot_that_is_not_found_is_never_made_up(given: Path, tmp_path: Path):
    image, camera = given / "image.png", given / "camera.yaml"
    with pytest.raises(SightingError, match=r"none of 1 images \(image 0: too dark\)"):
        fuse(*maps(given), **POSES, image=image, camera=camera, out=tmp_path / "out", pose_estimator=Seeing())
    assert not (tmp_path / "out").exists()


def test_an_empty_map_is_told(given: Path, tmp_path: Path):
    empty = OccupancyGrid(cells=np.full((9, 9), UNKNOWN, np.uint8), resolution_m=0.05, T_m_g=SE2.identity())
    write_ros_map(empty, tmp_path / "empty.yaml")
    with pytest.raises(MapError, match="map 1: none of its 81 cells is known"):
        fuse(given / "map0.yaml", tmp_path / "empty.yaml", **POSES, relative=T_R0_R1)


def test_the_command_fuses_by_a_relative_pose(given: Path, tmp_path: Path):
    error = T_R0_R1 @ SE2(0.4, -0.3, 0.2)
    shown = CliRunner().invoke(
        app,
        arguments(
            given,
            option("relative", *error.as_array()),
            "--relative-sigma=0.4,0.4,15",
            "--refine=correlative",
            "--out",
            str(tmp_path),
        ),
    )
    assert shown.exit_code == 0, shown.output
    assert shown.stdout.startswith("accepted\nmap 1 lies at x ")
    told = json.loads((tmp_path / "result.json").read_text())
    assert off(SE2(**told["T_m0_m1"])) < 0.1
    assert told["inputs"]["relative_sigma"] == pytest.approx([0.4, 0.4, math.radians(15.0)])


def test_the_maps_can_be_weighed_against_each_other(given: Path, tmp_path: Path):
    seen = option("relative", *T_R0_R1.as_array())
    words = arguments(given, seen, "--refine=none", "--merge=probabilistic", "--out", str(tmp_path))
    shown = CliRunner().invoke(app, words)
    assert shown.exit_code == 0, shown.output
    weighed = read_ros_map(tmp_path / "fused.yaml", strict=True)
    result = fuse(*maps(given), **POSES, relative=T_R0_R1, refine="none", merge="probabilistic")
    expected = probabilistically_merged(*cuts(0)[:2], result.T_m0_m1).grid
    np.testing.assert_array_equal(result.grid.cells, expected.cells)
    np.testing.assert_array_equal(weighed.cells, expected.cells)
    occupied = fuse(*maps(given), **POSES, relative=T_R0_R1, refine="none").grid
    assert weighed.occupied().sum() < occupied.occupied().sum()
    assert json.loads((tmp_path / "result.json").read_text())["inputs"]["merge"] == "probabilistic"


@pytest.mark.parametrize("strict", [False, True])
def test_the_command_tells_of_unknown_cells_that_would_become_free(given: Path, tmp_path: Path, strict: bool):
    map_1 = (given / "map1.yaml").read_text().replace("free_thresh: 0.196", "free_thresh: 0.25")
    (given / "trap.yaml").write_text(map_1)
    words = arguments(given, option("relative", *T_R0_R1.as_array()), "--refine=none", "--out", str(tmp_path))
    words[words.index(str(given / "map1.yaml"))] = str(given / "trap.yaml")
    shown = CliRunner().invoke(app, [*words, *(["--strict"] if strict else [])])
    assert shown.exit_code == 0, shown.output
    assert ("read as unknown" in shown.stderr) is not strict
    assert bool(json.loads((tmp_path / "result.json").read_text())["warnings"]) is not strict


GOOD = "--relative=1,0,3"


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ([], "give --image with --camera, or --relative"),
        ([GOOD, "--image=x.png", "--camera=c.yaml"], "--image and --relative: give one of them"),
        (["--image=x.png"], "--camera is missing"),
        ([GOOD, "--camera=c.yaml"], "--camera: belongs to --image"),
        ([GOOD, "--camera-pose=0,0,0,0,0,0"], "--camera-pose: belongs to --image"),
        (
            ["--image=x.png", "--camera=c.yaml", "--relative-sigma=1,1,1"],
            "--relative-sigma: belongs to --relative",
        ),
        ([GOOD, "--relative-sigma=1,1"], "must be x_m,y_m,yaw_deg: 3 finite numbers"),
        ([GOOD, "--relative-sigma=0,1,1"], "must be standard deviations above 0"),
        (["--relative=1,2"], "--relative is '1,2'; must be x,y,yaw: 3 finite numbers"),
        (["--relative=1,nan,0"], "--relative is '1,nan,0'; must be x,y,yaw"),
        ([GOOD, "--pose0=1,2,inf"], "--pose0 is '1,2,inf'"),
        ([GOOD, "--pose1=here"], "--pose1 is 'here'"),
        (
            ["--image=x.png", "--camera=c.yaml", "--camera-pose=1,2,3"],
            "x,y,z,roll,pitch,yaw: 6 finite numbers",
        ),
        ([GOOD, "--refine=best"], "--refine is 'best'; must be one of none, learned, correlative, auto"),
        ([GOOD, "--merge=best"], "--merge is 'best'; must be one of occupied, probabilistic"),
        ([GOOD, "--map0=nowhere.yaml"], "nowhere.yaml"),
        (["--image=nowhere.png", "--camera=nowhere.yaml"], "nowhere.yaml"),
        ([GOOD, "--robot=walker"], "known robots are burger"),
    ],
)
def test_a_wrong_command_is_one_line_and_exit_2(given: Path, more: list[str], said: str):
    shown = CliRunner().invoke(app, arguments(given, *more))
    assert shown.exit_code == 2
    assert shown.stderr.count("\n") == 1
    assert said in shown.stderr


def test_the_command_knows_every_choice():
    """It names them itself, so that a wrong one is told before anything heavy is imported."""
    assert tuple(Refinement) == REFINEMENTS
    assert tuple(Merging) == MERGINGS


def test_a_heavy_package_that_it_needs_only_a_little_of_is_left_out():
    """`scipy.stats` takes half of the start; its distributions are in `scipy.special` as well."""
    code = (
        "import sys, rendezvous.commands.fuse.fuse, rendezvous.commands.fuse.outputs\n"
        "print({'scipy.stats', 'torch'} & set(sys.modules))"
    )
    shown = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert shown.stdout == "set()\n"


def test_wrong_options_are_told_before_anything_heavy_is_imported():
    code = (
        "import sys; from rendezvous.cli.__main__ import main\n"
        "sys.argv = 'rendezvous fuse --map0 a --map1 b --pose0 1,2 --pose1 0,0,0 --relative 1,0,0'.split()\n"
        "try: main()\n"
        "except SystemExit as stop: print(stop.code, {'numpy', 'torch', 'cv2'} & set(sys.modules))"
    )
    shown = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert shown.stdout == "2 set()\n"


@pytest.mark.parametrize("refine", ["auto", "learned", "correlative"])
def test_the_real_pair_is_fused_from_perturbed_starts(real_data: Path, refine: str):
    """Its registration is good to some decimetres and degrees; both methods agree with each other to less."""
    grid_0, grid_1, T_m0_centre = real_maps(real_data)
    pose1 = REAL_T_M0_M1.inverse() @ T_m0_centre @ SE2(0.0, 0.0, 2.0)
    pose0 = SE2(T_m0_centre.x_m - 1.5, T_m0_centre.y_m, 0.0)
    rng = np.random.default_rng(3)
    for _ in range(3):
        error = SE2.from_array(rng.normal(0.0, [0.4, 0.4, 0.2]))
        result = fuse(
            grid_0,
            grid_1,
            pose0=pose0,
            pose1=pose1,
            relative=SE2(1.5, 0.0, 2.0) @ error,
            relative_sigma=(0.4, 0.4, 0.2),
            refine=refine,
        )
        left = frame_error(result.T_m0_m1, REAL_T_M0_M1, T_m0_centre)
        assert math.hypot(left.x_m, left.y_m) < 0.3
        assert abs(left.yaw_rad) < math.radians(3.0)
        assert result.after.wall_share > 0.9
        assert result.verdict.accepted, str(result.verdict)
