"""`rendezvous see`: what the network sees in an image, as words, JSON and a picture; no maps needed."""

import json

import cv2
import numpy as np
import pytest

from rendezvous.commands.see import Seen, see, write_seen
from rendezvous.errors import CameraError, ConfigError, StoreError
from rendezvous.geometry.camera import se3_from_se2
from rendezvous.geometry.se2 import SE2
from rendezvous.pose_estimation.pose_estimate import PoseMode, RelativePose
from rendezvous.resources import SIGHTING
from rendezvous.robot_file import load_robot

torch = pytest.importorskip("torch")

IMAGE, CAMERA = SIGHTING / "image.jpg", SIGHTING / "camera.yaml"
BURGER = load_robot("burger")


@pytest.fixture(scope="module")
def seen():
    return see([IMAGE], CAMERA)


def of_pose(T_r0_r1, name="a/photo.png"):
    mode = PoseMode(
        T_r0_r1=T_r0_r1, covariance=np.diag([0.04, 0.01, 0.0004]), mass=1.0, T_c_o=np.eye(4),
        degrees_of_freedom=5.0,
    )  # fmt: skip
    pose = RelativePose(modes=(mode,), score=0.9, keypoints_px=np.zeros((9, 2)))
    return Seen(name=name, pose=pose, robot=BURGER, T_r0_c=BURGER.camera.T_r_c(), picture=b"png")


def test_the_shipped_sighting_is_seen_where_fuse_sees_it(seen):
    (one,) = seen
    record = json.loads(json.dumps(one.record()))
    assert record["found"]
    assert record["modes"][0]["mass"] > 0.9
    T = SE2(**record["modes"][0]["T_r0_r1"])
    assert (T.x_m, T.y_m) == pytest.approx((1.90, -0.46), abs=0.06)
    assert np.degrees(T.yaw_rad) == pytest.approx(-127.4, abs=5.0)
    assert one.lines()[0] == f"{IMAGE}: robot found, score {one.pose.score:.2f}"


def test_distance_and_bearing_are_those_of_a_tape_measure_on_the_floor():
    """Robot 1's middle 2 m straight ahead of the lens, its front 30 degrees to the left of robot 0's."""
    lens_x_m = BURGER.camera.xyz_m[0]
    T_r0_r1 = SE2(lens_x_m + 2.0, 0.0, np.radians(30.0)) @ SE2(-BURGER.cuboid.centre_m[0], 0.0, 0.0)
    lines = of_pose(T_r0_r1).lines()
    assert "along the floor: 2.000 m" in lines[2]
    # The lens lies at 180 degrees - 30 degrees, clockwise from robot 1's front.
    assert lines[2].endswith("the lens is 150° to the left of its front")
    assert "(±0.200 m, ±1.1°)" in lines[1]
    T_r1_c = np.linalg.inv(se3_from_se2(T_r0_r1)) @ BURGER.camera.T_r_c()
    assert np.arctan2(T_r1_c[1, 3], T_r1_c[0, 3] + 0.032) == pytest.approx(np.radians(150.0))
    mirrored = of_pose(SE2(lens_x_m + 2.0, 0.0, np.radians(-30.0)) @ SE2(0.032, 0.0, 0.0)).lines()
    assert mirrored[2].endswith("150° to the right of its front")


def test_pictures_and_readings_are_written(seen, tmp_path):
    picture, record = write_seen(seen, tmp_path / "out")
    assert picture == tmp_path / "out" / "image.png"
    assert cv2.imread(str(picture)).shape[1] == cv2.imread(str(IMAGE)).shape[1]
    assert json.loads(record.read_text())[0]["image"] == str(IMAGE)


def test_an_empty_room_says_why_nothing_was_found(tmp_path):
    height, width = cv2.imread(str(IMAGE)).shape[:2]
    cv2.imwrite(str(tmp_path / "wall.png"), np.full((height, width, 3), 180, np.uint8))
    (one,) = see([tmp_path / "wall.png"], CAMERA)
    assert not one.pose.found
    assert one.lines() == [f"{tmp_path / 'wall.png'}: no robot found ({one.pose.reason})"]
    assert one.record()["modes"] == []


def test_images_of_one_name_are_not_written_over_each_other(tmp_path):
    with pytest.raises(StoreError, match=r"two images would be written to photo\.png"):
        write_seen([of_pose(SE2(1, 0, 0)), of_pose(SE2(1, 0, 0), name="b/photo.png")], tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_wrong_input_is_told_before_the_network_is_loaded(tmp_path):
    with pytest.raises(CameraError, match="no such file"):
        see([tmp_path / "none.png"], CAMERA)
    with pytest.raises(ConfigError, match="camera pose"):
        see([IMAGE], CAMERA, camera_pose=(0.0, 0.0, 1.0))
