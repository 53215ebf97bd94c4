"""A scene in the BOP format (Benchmark for 6D Object Pose), which the BOP toolkit reads.

    camera.json                          camera_document
    models/models_info.json              models_info_document
    models/obj_000001.ply                model_ply
    test_targets_bop19.json              targets_document
    train/000000/scene_camera.json       scene_camera_document
    train/000000/scene_gt.json           scene_gt_document
    train/000000/scene_gt_info.json      scene_gt_info_document
    train/000000/rgb/000000.png

Lengths are in millimetres. The model's frame is o, with its origin at the centre of the model's box and z up,
as BOP wants it; the camera frame is OpenCV's, with pixel (0, 0) at the centre of the first pixel. There are
no depth images: `depth_scale` is there because the format requires it, and `px_count_valid`, a count of depth
pixels, is 0.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from rendezvous.errors import PipelineError
from rendezvous.geometry.camera import PinholeCamera
from rendezvous.geometry.se2 import Array
from rendezvous.interop.pose_label import Box, PoseLabel
from rendezvous.rendering.appearance.colour import srgb_from_linear
from rendezvous.rendering.robot_model import part_material

MM_PER_M = 1000.0

NO_BOX = [-1, -1, -1, -1]  # the toolkit's box of an object that is not visible

TARGET_VISIBILITY = 0.1  # the benchmark's targets are objects with at least this visible share

Images = Mapping[int, PoseLabel]  # labels by image number


def camera_document(camera: PinholeCamera) -> dict[str, Any]:
    """`camera.json`: the camera of the whole dataset."""
    return {
        "fx": camera.fx_px,
        "fy": camera.fy_px,
        "cx": camera.cx_px,
        "cy": camera.cy_px,
        "width": camera.width_px,
        "height": camera.height_px,
        "depth_scale": 1.0,
    }


def scene_camera_document(images: Images) -> dict[str, Any]:
    """`scene_camera.json`: the camera of each image."""
    return {
        str(i): {"cam_K": label.camera.K().ravel().tolist(), "depth_scale": 1.0}
        for i, label in images.items()
    }


def scene_gt_document(images: Images, *, obj_id: int) -> dict[str, Any]:
    """`scene_gt.json`: the pose of the robot in each image; an empty list without one."""
    return {
        str(i): [_gt(label.T_c_o, obj_id)] if label.T_c_o is not None else [] for i, label in images.items()
    }


def _gt(T_c_o: Array, obj_id: int) -> dict[str, Any]:
    return {
        "obj_id": obj_id,
        "cam_R_m2c": T_c_o[:3, :3].ravel().tolist(),
        "cam_t_m2c": (MM_PER_M * T_c_o[:3, 3]).tolist(),
    }


def scene_gt_info_document(images: Images, vertices_o_m: Array) -> dict[str, Any]:
    """`scene_gt_info.json`: boxes and pixel counts of the robot in each image.

    Args:
        images: their labels.
        vertices_o_m: (N, 3) vertices of the robot's mesh in o, whose projection gives the silhouette's box.
    """
    hull_o_m = vertices_o_m[ConvexHull(vertices_o_m).vertices]
    return {
        str(i): [_gt_info(label, label.T_c_o, hull_o_m)] if label.T_c_o is not None else []
        for i, label in images.items()
    }


def _gt_info(label: PoseLabel, T_c_o: Array, hull_o_m: Array) -> dict[str, Any]:
    visible = label.box_px is not None
    return {
        "bbox_obj": _silhouette_box(label.camera, T_c_o, hull_o_m) if visible else NO_BOX,
        "bbox_visib": _bop_box(label.box_px) if label.box_px is not None else NO_BOX,
        "px_count_all": label.silhouette_px,
        "px_count_valid": 0,
        "px_count_visib": label.visible_px,
        "visib_fract": label.visibility,
    }


def _bop_box(box_px: Box) -> list[int]:
    """x, y, width, height between the first and last pixel's indices: a box of one pixel has width 0."""
    x0, y0, x1, y1 = box_px
    return [round(v) for v in (x0 + 0.5, y0 + 0.5, x1 - x0 - 1.0, y1 - y0 - 1.0)]


def _silhouette_box(camera: PinholeCamera, T_c_o: Array, hull_o_m: Array) -> list[int]:
    """Box of the pixels whose centres the robot covers, including those outside the image."""
    uv_px = camera.project(hull_o_m @ T_c_o[:3, :3].T + T_c_o[:3, 3])
    if np.isnan(uv_px).any():
        raise PipelineError("label: a part of the robot is behind the camera, so its silhouette has no box")
    low, high = np.ceil(uv_px.min(axis=0)), np.floor(uv_px.max(axis=0))
    return [int(v) for v in (*low, *(high - low))]


def targets_document(images: Images, *, obj_id: int, scene_id: int) -> list[dict[str, int]]:
    """`test_targets_bop19.json`: images of the test split in which the robot must be found."""
    return [
        {"im_id": i, "inst_count": 1, "obj_id": obj_id, "scene_id": scene_id}
        for i, label in images.items()
        if label.visibility >= TARGET_VISIBILITY
    ]


def models_info_document(models_o_m: Mapping[int, Array]) -> dict[str, Any]:
    """`models_info.json`: box and diameter [mm] of each model, from its vertices (N, 3) [m] in o."""
    return {str(obj_id): _model_info(MM_PER_M * vertices) for obj_id, vertices in models_o_m.items()}


def _model_info(vertices_mm: Array) -> dict[str, float]:
    low, size = vertices_mm.min(axis=0), np.ptp(vertices_mm, axis=0)
    corners = vertices_mm[ConvexHull(vertices_mm).vertices]
    info = {"diameter": float(pdist(corners).max())}
    for i, axis in enumerate("xyz"):
        info |= {f"min_{axis}": float(low[i]), f"size_{axis}": float(size[i])}
    return info


def model_vertices(parts: Mapping[str, trimesh.Trimesh], T_r_o: Array) -> Array:
    """(N, 3) [m] vertices in o of a robot's parts given in r."""
    p_r = np.concatenate([np.asarray(part.vertices) for part in parts.values()])
    return (p_r - T_r_o[:3, 3]) @ T_r_o[:3, :3]


def model_ply(parts: Mapping[str, trimesh.Trimesh], T_r_o: Array) -> bytes:
    """`obj_000001.ply`: the robot in o [mm], binary, with normals and the parts' colours in sRGB.

    Args:
        parts: in r, as `rendering.robot_model.robot_parts` gives them.
        T_r_o: (4, 4) pose of the cuboid in r.
    """
    vertex = np.dtype(
        [*((n, "<f4") for n in ("x", "y", "z", "nx", "ny", "nz")), *((n, "u1") for n in _COLOURS)]
    )
    face = np.dtype([("count", "u1"), ("vertices", "<i4", 3)])
    vertices = np.empty(sum(len(part.vertices) for part in parts.values()), vertex)
    faces = np.empty(sum(len(part.faces) for part in parts.values()), face)
    xyz_mm = MM_PER_M * model_vertices(parts, T_r_o)
    normals = np.concatenate([np.asarray(part.vertex_normals) for part in parts.values()]) @ T_r_o[:3, :3]
    for name, values in zip(("x", "y", "z", "nx", "ny", "nz"), (*xyz_mm.T, *normals.T), strict=True):
        vertices[name] = values
    colours = [
        np.tile(
            np.round(255.0 * srgb_from_linear(np.array(part_material(p).base_colour_rgb))),
            (len(p.vertices), 1),
        )
        for p in parts.values()
    ]
    for name, values in zip(_COLOURS, np.concatenate(colours).T, strict=True):
        vertices[name] = values
    starts = np.cumsum([0, *(len(part.vertices) for part in parts.values())])
    faces["count"] = 3
    faces["vertices"] = np.concatenate([p.faces + i for p, i in zip(parts.values(), starts, strict=False)])
    return _ply_header(len(vertices), len(faces)) + vertices.tobytes() + faces.tobytes()


_COLOURS = ("red", "green", "blue")


def _ply_header(vertices: int, faces: int) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {vertices}"]
    lines += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    lines += [f"property uchar {name}" for name in _COLOURS]
    lines += [f"element face {faces}", "property list uchar int vertex_indices", "end_header"]
    return ("\n".join(lines) + "\n").encode()


def bop_json(document: Mapping[str, Any] | Sequence[Any]) -> bytes:
    """A document in the toolkit's layout: one entry per line."""
    if isinstance(document, Mapping):
        lines = [f"  {json.dumps(key)}: {json.dumps(value)}" for key, value in document.items()]
        return ("{\n" + ",\n".join(lines) + "\n}\n").encode()
    return ("[\n" + ",\n".join(f"  {json.dumps(entry)}" for entry in document) + "\n]\n").encode()
