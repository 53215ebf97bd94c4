from __future__ import annotations

import io
import json

import cv2
import numpy as np
import pytest
import trimesh

from rendezvous.errors import PipelineError
from rendezvous.geometry.cuboid import cuboid_points
from rendezvous.interop.bop import (
    bop_json,
    camera_document,
    model_ply,
    model_vertices,
    models_info_document,
    scene_camera_document,
    scene_gt_document,
    scene_gt_info_document,
    targets_document,
)
from rendezvous.interop.pose_label import PoseLabel
from rendezvous.rendering.robot_model import robot_parts
from rendezvous.robot_file import ROBOTS, load_robot
from tests.geometry.test_cuboid import CAMERA, SIZE_M, random_pose

CORNERS_O_M = cuboid_points(SIZE_M)[:8]


def _label(T_c_o: np.ndarray | None, **changes: object) -> PoseLabel:
    fields = {
        "camera": CAMERA,
        "cuboid_size_m": SIZE_M,
        "T_c_o": T_c_o,
        "visible_px": 60,
        "silhouette_px": 80,
        "box_px": (9.5, 19.5, 29.5, 22.5),
    }
    return PoseLabel(**(fields | changes))


@pytest.fixture
def images() -> dict[int, PoseLabel]:
    """One image with the robot, one with a hidden one, one without."""
    rng = np.random.default_rng(0)
    return {
        0: _label(random_pose(rng)),
        7: _label(random_pose(rng), visible_px=0, box_px=None),
        12: _label(None, visible_px=0, silhouette_px=0, box_px=None),
    }


@pytest.fixture(scope="module")
def burger() -> dict[str, trimesh.Trimesh]:
    return robot_parts((ROBOTS / "burger" / "robot.glb").read_bytes(), source="burger")


def _read(document: dict) -> dict:
    """What the toolkit reads: JSON whose keys are numbers."""
    return {int(key): value for key, value in json.loads(bop_json(document)).items()}


def test_the_scenes_camera_has_the_fields_of_the_format(images):
    document = _read(scene_camera_document(images))
    assert list(document) == [0, 7, 12]
    for entry in document.values():
        assert set(entry) == {"cam_K", "depth_scale"}
        assert np.array_equal(np.reshape(entry["cam_K"], (3, 3)), CAMERA.K())
        assert entry["depth_scale"] == 1.0


def test_poses_are_in_millimetres_and_row_by_row(images):
    document = _read(scene_gt_document(images, obj_id=1))
    assert [len(entries) for entries in document.values()] == [1, 1, 0]
    (entry,) = document[0]
    assert set(entry) == {"obj_id", "cam_R_m2c", "cam_t_m2c"}
    assert entry["obj_id"] == 1
    # P_m2i of the format's documentation: s p_i = K [R, t] p_m.
    P = CAMERA.K() @ np.column_stack([np.reshape(entry["cam_R_m2c"], (3, 3)), entry["cam_t_m2c"]])
    p = np.column_stack([1000.0 * cuboid_points(SIZE_M), np.ones(9)]) @ P.T
    assert p[:, :2] / p[:, 2:] == pytest.approx(images[0].projected_cuboid_px())


def test_the_meta_information_has_the_fields_of_the_format(images):
    document = _read(scene_gt_info_document(images, CORNERS_O_M))
    assert [len(entries) for entries in document.values()] == [1, 1, 0]
    (seen,), (hidden,) = document[0], document[7]
    for entry in (seen, hidden):
        assert set(entry) == {
            "bbox_obj",
            "bbox_visib",
            "px_count_all",
            "px_count_valid",
            "px_count_visib",
            "visib_fract",
        }
    assert seen["px_count_valid"] == hidden["px_count_valid"] == 0  # there are no depth images
    assert (hidden["px_count_all"], hidden["px_count_visib"]) == (80, 0)
    assert seen["bbox_visib"] == [10, 20, 19, 2]
    assert (seen["px_count_all"], seen["px_count_visib"], seen["visib_fract"]) == (80, 60, 0.75)
    assert hidden["bbox_obj"] == hidden["bbox_visib"] == [-1, -1, -1, -1]
    assert hidden["visib_fract"] == 0.0


def test_the_silhouettes_box_holds_the_pixels_that_the_robot_covers():
    rng = np.random.default_rng(1)
    for _ in range(8):
        T_c_o = random_pose(rng)
        info = scene_gt_info_document({0: _label(T_c_o)}, CORNERS_O_M)["0"][0]
        # The toolkit's rule: first and last pixel of a mask on a canvas large enough.
        hull_px = cv2.convexHull(
            CAMERA.project(CORNERS_O_M @ T_c_o[:3, :3].T + T_c_o[:3, 3]).astype(np.float32)
        )
        low, high = np.floor(hull_px.min(axis=(0, 1))) - 1, np.ceil(hull_px.max(axis=(0, 1))) + 1
        cols, rows = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        inside = [
            (u, v)
            for u, v in zip(cols.ravel(), rows.ravel(), strict=True)
            if cv2.pointPolygonTest(hull_px, (float(u), float(v)), False) >= 0
        ]
        mask = np.array(inside)
        x, y, width, height = info["bbox_obj"]
        # A corner can lie between the centres of four pixels and then covers none of them.
        assert np.abs(mask.min(axis=0) - [x, y]).max() <= 1
        assert np.abs(mask.max(axis=0) - [x + width, y + height]).max() <= 1


def test_the_silhouettes_box_begins_and_ends_at_the_centres_of_pixels():
    near_px = np.array([[10.2, 20.7], [30.9, 20.7], [30.9, 40.1], [10.2, 40.1]])
    K, far_px = CAMERA.K(), near_px.mean(axis=0) + 0.5 * (near_px - near_px.mean(axis=0))
    rays = np.column_stack([(np.vstack([near_px, far_px]) - K[:2, 2]) / K[[0, 1], [0, 1]], np.ones(8)])
    vertices = rays * np.repeat([1.0, 1.1], 4)[:, None]
    (info,) = scene_gt_info_document({0: _label(np.eye(4))}, vertices)["0"]
    assert info["bbox_obj"] == [11, 21, 19, 19]


def test_a_robot_that_is_partly_behind_the_camera_has_no_box():
    T_c_o = np.eye(4)
    T_c_o[2, 3] = 0.05
    with pytest.raises(PipelineError, match="part of the robot is behind the camera"):
        scene_gt_info_document({0: _label(T_c_o)}, CORNERS_O_M)


def test_targets_are_the_images_of_which_a_tenth_of_the_robot_is_visible(images):
    rng = np.random.default_rng(3)
    labels = images | {
        20: _label(random_pose(rng), visible_px=8),
        21: _label(random_pose(rng), visible_px=7),
    }
    entries = json.loads(bop_json(targets_document(labels, obj_id=1, scene_id=4)))
    assert entries == [{"im_id": i, "inst_count": 1, "obj_id": 1, "scene_id": 4} for i in (0, 20)]


def test_a_list_has_an_entry_a_line():
    assert bop_json([{"a": 1}, {"a": 2}]) == b'[\n  {"a": 1},\n  {"a": 2}\n]\n'
    assert json.loads(bop_json([])) == []


def test_the_models_box_and_diameter_are_in_millimetres():
    info = json.loads(bop_json(models_info_document({1: CORNERS_O_M})))["1"]
    assert info == {
        "diameter": pytest.approx(1000.0 * np.linalg.norm(SIZE_M)),
        "min_x": pytest.approx(-69.0),
        "min_y": pytest.approx(-89.0),
        "min_z": pytest.approx(-96.0),
        "size_x": pytest.approx(138.0),
        "size_y": pytest.approx(178.0),
        "size_z": pytest.approx(192.0),
    }


def test_the_models_diameter_is_the_largest_distance_of_two_vertices(burger):
    vertices = model_vertices(burger, load_robot("burger").cuboid.T_r_o())
    some = 1000.0 * np.concatenate([vertices[::37], vertices[np.abs(vertices[:, 1]) > 0.0885]])
    largest_mm = max(float(np.linalg.norm(some - p, axis=1).max()) for p in some)
    diameter_mm = models_info_document({1: vertices})["1"]["diameter"]
    assert largest_mm <= diameter_mm <= largest_mm + 10.0


def test_the_models_file_opens_elsewhere(burger):
    T_r_o = load_robot("burger").cuboid.T_r_o()
    mesh = trimesh.load_mesh(io.BytesIO(model_ply(burger, T_r_o)), file_type="ply", process=False)
    assert mesh.vertices == pytest.approx(1000.0 * model_vertices(burger, T_r_o), abs=1e-3)
    assert np.abs(mesh.bounds) == pytest.approx(500.0 * np.tile(SIZE_M, (2, 1)), abs=0.6)
    assert mesh.area == pytest.approx(1e6 * sum(part.area for part in burger.values()), rel=1e-5)


def _vertex_properties(ply: bytes) -> dict[str, np.ndarray]:
    """The vertices' properties by the header alone, with the types that the toolkit's reader knows."""
    header, _, body = ply.partition(b"end_header\n")
    lines = header.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    (count,) = (int(line.split()[-1]) for line in lines if line.startswith("element vertex"))
    properties = [line.split()[1:] for line in lines if line.startswith("property") and "list" not in line]
    assert "property list uchar int vertex_indices" in lines
    types = {"float": "<f4", "double": "<f8", "int": "<i4", "uchar": "u1"}
    table = np.frombuffer(body, np.dtype([(name, types[kind]) for kind, name in properties]), count)
    return {name: table[name].astype(float) for _, name in properties}


def test_the_models_file_has_colours_and_normals(burger):
    vertex = _vertex_properties(model_ply(burger, load_robot("burger").cuboid.T_r_o()))
    normals = np.column_stack([vertex["nx"], vertex["ny"], vertex["nz"]])
    assert np.allclose(normals, np.concatenate([part.vertex_normals for part in burger.values()]), atol=1e-6)
    first = sum(len(part.vertices) for name, part in burger.items() if name < "board.pi")
    # The board is (0.01, 0.18, 0.05) in linear light; by the definition of sRGB that is this green.
    assert [vertex[c][first] for c in ("red", "green", "blue")] == pytest.approx([25.0, 118.0, 63.0], abs=3.0)


def test_the_camera_file_names_what_the_toolkit_loads():
    document = json.loads(bop_json(camera_document(CAMERA)))
    assert document == {
        "fx": 616.0,
        "fy": 610.0,
        "cx": 319.5,
        "cy": 239.5,
        "width": 640,
        "height": 480,
        "depth_scale": 1.0,
    }


def test_a_scene_without_images_is_still_json():
    assert json.loads(bop_json(scene_camera_document({}))) == {}


def test_vertices_are_seen_from_the_cuboid_however_it_is_turned():
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    T_r_o = random_pose(np.random.default_rng(0))
    back = model_vertices({"box": box}, T_r_o) @ T_r_o[:3, :3].T + T_r_o[:3, 3]
    assert back == pytest.approx(np.asarray(box.vertices))
