from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from rendezvous.errors import PipelineError
from rendezvous.geometry.camera import PinholeCamera
from rendezvous.interop.dope_json import dope_document, dope_json, read_dope_document
from rendezvous.interop.pose_label import PoseLabel
from tests.geometry.test_cuboid import CAMERA, SIZE_M, error, random_pose

BOX_PX = (99.5, 49.5, 200.5, 150.5)


def _label(T_c_o: np.ndarray | None, *, visible_px: int = 750, silhouette_px: int = 1000) -> PoseLabel:
    return PoseLabel(
        camera=CAMERA,
        cuboid_size_m=SIZE_M,
        T_c_o=T_c_o,
        visible_px=visible_px,
        silhouette_px=silhouette_px,
        box_px=BOX_PX if visible_px else None,
    )


def _written(label: PoseLabel) -> dict:
    """What another program reads from the file."""
    return json.loads(dope_json(label, class_name="burger"))


@pytest.fixture
def pose() -> np.ndarray:
    return random_pose(np.random.default_rng(0))


def test_the_file_has_the_fields_that_dope_reads(pose):
    document = _written(_label(pose))
    assert set(document) == {"camera_data", "objects"}
    camera = document["camera_data"]
    assert {"width", "height", "intrinsics", "camera_look_at", "camera_view_matrix"} <= set(camera)
    assert {"location_worldframe", "quaternion_xyzw_worldframe"} <= set(camera)
    assert set(camera["camera_look_at"]) == {"at", "eye", "up"}
    assert camera["intrinsics"] == {"fx": 616.0, "fy": 610.0, "cx": 319.5, "cy": 239.5}
    assert (camera["width"], camera["height"]) == (640, 480)
    (entry,) = document["objects"]
    assert {"class", "name", "provenance", "visibility", "location", "quaternion_xyzw"} <= set(entry)
    assert entry["class"] == "burger"
    assert entry["visibility"] == 0.75
    assert (entry["px_count_visib"], entry["px_count_all"], entry["name"]) == (750, 1000, "burger_000")
    # The camera's frame is the file's world.
    assert camera["camera_view_matrix"] == np.eye(4).tolist()
    assert camera["location_worldframe"] == [0.0, 0.0, 0.0]
    assert camera["quaternion_xyzw_worldframe"] == [0.0, 0.0, 0.0, 1.0]
    assert np.array(entry["projected_cuboid"]).shape == (9, 2)
    assert entry["location"] == pytest.approx(100.0 * pose[:3, 3])
    assert np.linalg.norm(entry["quaternion_xyzw"]) == pytest.approx(1.0)


def test_the_look_at_is_the_cameras_own_frame(pose):
    look = _written(_label(pose))["camera_data"]["camera_look_at"]
    forward = np.subtract(look["at"], look["eye"])
    assert np.array_equal(np.cross(forward, look["up"]), [1.0, 0.0, 0.0])  # right


def _cuboid3d_cm(width: float, height: float, depth: float) -> np.ndarray:
    """(9, 3) corners as DOPE's Cuboid3d defines them: x to the right, y down, z to the front."""
    right, left = +width / 2, -width / 2
    top, bottom = -height / 2, +height / 2
    front, rear = +depth / 2, -depth / 2
    return np.array(
        [
            [right, top, front],
            [left, top, front],
            [left, bottom, front],
            [right, bottom, front],
            [right, top, rear],
            [left, top, rear],
            [left, bottom, rear],
            [right, bottom, rear],
            [0, 0, 0],
        ]
    )


def test_dopes_cuboid_and_pnp_give_the_pose_that_the_file_states():
    rng = np.random.default_rng(1)
    corners_cm = _cuboid3d_cm(*(100.0 * side for side in SIZE_M))
    for _ in range(100):
        T_c_o = random_pose(rng)
        document = _written(_label(T_c_o))
        K = np.eye(3)
        intrinsics = document["camera_data"]["intrinsics"]
        K[0, 0], K[1, 1], K[0, 2], K[1, 2] = (intrinsics[name] for name in ("fx", "fy", "cx", "cy"))
        uv_px = np.array(document["objects"][0]["projected_cuboid"])
        found, rvec, tvec_cm = cv2.solvePnP(corners_cm, uv_px, K, np.zeros((4, 1)), flags=cv2.SOLVEPNP_EPNP)
        assert found
        assert tvec_cm.ravel() == pytest.approx(np.array(document["objects"][0]["location"]), abs=0.1)
        T_solved = np.eye(4)
        T_solved[:3, :3], T_solved[:3, 3] = cv2.Rodrigues(rvec)[0], tvec_cm.ravel() / 100.0
        distance_m, angle_rad = error(T_c_o, T_solved)
        assert distance_m < 1e-3
        assert angle_rad < np.radians(0.1)


def test_the_quaternion_is_x_y_z_w():
    T_c_o = np.eye(4)
    T_c_o[:3, :3] = cv2.Rodrigues(np.array([0.0, 0.0, np.radians(60.0)]))[0]
    T_c_o[2, 3] = 1.0
    quat_xyzw = _written(_label(T_c_o))["objects"][0]["quaternion_xyzw"]
    assert quat_xyzw == pytest.approx([0.0, 0.0, 0.5, np.sqrt(0.75)])


def test_reading_gives_back_what_was_written():
    rng = np.random.default_rng(2)
    for _ in range(20):
        label = _label(random_pose(rng))
        camera, (seen,) = read_dope_document(_written(label), source="x.json")
        assert camera == label.camera
        assert (seen.class_name, seen.visibility) == ("burger", 0.75)
        assert seen.T_c_o == pytest.approx(label.T_c_o, abs=1e-9)
        assert seen.projected_cuboid_px == pytest.approx(label.projected_cuboid_px())


def test_points_behind_the_camera_are_marked_as_dope_marks_what_is_hidden():
    T_c_o = np.eye(4)
    T_c_o[2, 3] = 0.05
    document = _written(_label(T_c_o))
    assert document["objects"][0]["projected_cuboid"][4:8] == [[-100.0, -100.0]] * 4
    _, (seen,) = read_dope_document(document, source="x.json")
    assert np.array_equal(np.isnan(seen.projected_cuboid_px).all(axis=1), [False] * 4 + [True] * 4 + [False])


@pytest.mark.parametrize("hidden", [True, False])
def test_an_image_without_a_visible_robot_has_no_objects(pose, hidden):
    label = _label(pose if hidden else None, visible_px=0, silhouette_px=1000 if hidden else 0)
    assert label.visibility == 0.0
    document = _written(label)
    assert document["objects"] == []
    assert read_dope_document(document, source="x.json") == (CAMERA, [])


def test_eight_points_and_a_centroid_are_read_as_nine(pose):
    document = dope_document(_label(pose), class_name="burger")
    entry = document["objects"][0]
    *entry["projected_cuboid"], entry["projected_cuboid_centroid"] = entry["projected_cuboid"]
    del entry["location"]
    _, (seen,) = read_dope_document(document, source="x.json")
    assert seen.projected_cuboid_px == pytest.approx(_label(pose).projected_cuboid_px())
    assert seen.T_c_o is None


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("camera_data", "intrinsics"), {"fx": 1.0}, r"x\.json: no field 'fy'"),
        (("objects",), [{"class": "burger"}], r"x\.json: no field 'projected_cuboid'"),
        (("objects",), 3, r"x\.json: a field is of another shape"),
        (("camera_data",), {}, r"x\.json: no field 'intrinsics'"),
    ],
)
def test_a_file_of_another_kind_is_named_with_its_fault(pose, path, value, message):
    document = dope_document(_label(pose), class_name="burger")
    inner = document
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    with pytest.raises(PipelineError, match=message):
        read_dope_document(document, source="x.json")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"T_c_o": None}, "750 visible pixels of a robot that has no pose"),
        ({"silhouette_px": 700}, "750 visible of 700 pixels"),
        ({"box_px": None}, "box None around 750 pixels"),
    ],
)
def test_a_label_that_contradicts_itself_is_refused(pose, changes, message):
    fields = {
        "camera": PinholeCamera(fx_px=1.0, fy_px=1.0, cx_px=0.0, cy_px=0.0, width_px=2, height_px=2),
        "cuboid_size_m": SIZE_M,
        "T_c_o": pose,
        "visible_px": 750,
        "silhouette_px": 1000,
        "box_px": BOX_PX,
    }
    with pytest.raises(PipelineError, match=message):
        PoseLabel(**(fields | changes))
