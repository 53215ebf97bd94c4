"""DOPE's training labels: `X.json` beside `X.png`, in the format of Deep_Object_Pose's NViSII scripts.

The official loader reads `objects[]` with `class`, `visibility` (objects above 0 count) and
`projected_cuboid`; its evaluation also reads `location` and `quaternion_xyzw`. Poses are in the camera frame
(x right, y down, z forward), which is also the file's world: our labels have no other.

- `location` is in centimetres, as are the cuboid's dimensions in DOPE's configuration; all else is in pixels.
- Pixel (0, 0) is the centre of the first pixel, for `intrinsics` too: PnP gives the exact pose. NViSII's own
  files count from the corner of that pixel, half a pixel more.
- The object frame is o; DOPE's `Cuboid3d` takes the dimensions along x, y and z of o, in this order.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from rendezvous.errors import PipelineError
from rendezvous.geometry.camera import PinholeCamera
from rendezvous.geometry.se2 import Array
from rendezvous.interop.pose_label import PoseLabel

CM_PER_M = 100.0

ABSENT_PX = -100.0  # both coordinates of a point to be ignored, as of hidden objects in DOPE's loader


@dataclass(frozen=True, slots=True, kw_only=True)
class DopeObject:
    """One object of a file."""

    class_name: str  # DOPE's class
    visibility: float  # above 0 if it is visible
    projected_cuboid_px: Array  # (9, 2), centroid last; NaN for points to be ignored
    T_c_o: Array | None  # (4, 4) [m]; None if the file has no pose


def dope_document(label: PoseLabel, *, class_name: str) -> dict[str, Any]:
    """Content of `X.json`; `objects` is empty if the robot is absent or completely hidden."""
    camera = label.camera
    return {
        "camera_data": {
            "width": camera.width_px,
            "height": camera.height_px,
            "camera_look_at": {"at": [0.0, 0.0, 1.0], "eye": [0.0, 0.0, 0.0], "up": [0.0, -1.0, 0.0]},
            "camera_view_matrix": np.eye(4).tolist(),
            "location_worldframe": [0.0, 0.0, 0.0],
            "quaternion_xyzw_worldframe": [0.0, 0.0, 0.0, 1.0],
            "intrinsics": {"fx": camera.fx_px, "fy": camera.fy_px, "cx": camera.cx_px, "cy": camera.cy_px},
        },
        "objects": [_object(label, class_name)] if label.visible_px else [],
    }


def dope_json(label: PoseLabel, *, class_name: str) -> bytes:
    """`X.json` as bytes."""
    return json.dumps(dope_document(label, class_name=class_name), indent=2).encode() + b"\n"


def _object(label: PoseLabel, class_name: str) -> dict[str, Any]:
    T_c_o, uv_px = label.T_c_o, label.projected_cuboid_px()
    assert T_c_o is not None, "what is visible has a pose"
    assert uv_px is not None, "what is visible has a pose"
    uv_px = np.where(np.isfinite(uv_px), uv_px, ABSENT_PX)
    quat_xyzw = Rotation.from_matrix(T_c_o[:3, :3]).as_quat(canonical=True)
    return {
        "class": class_name,
        "name": f"{class_name}_000",
        "provenance": "rendezvous",
        "visibility": label.visibility,
        "px_count_visib": label.visible_px,
        "px_count_all": label.silhouette_px,
        "location": (CM_PER_M * T_c_o[:3, 3]).tolist(),
        "quaternion_xyzw": quat_xyzw.tolist(),
        "projected_cuboid": uv_px.tolist(),
    }


def read_dope_document(document: Mapping[str, Any], *, source: str) -> tuple[PinholeCamera, list[DopeObject]]:
    """Camera and objects of a DOPE label.

    Args:
        document: the parsed `X.json`, with nine points, or eight and `projected_cuboid_centroid`.
        source: its name, for errors.

    Raises:
        PipelineError: a field is missing or has the wrong shape; says which.
    """
    try:
        data = document["camera_data"]
        intrinsics = data["intrinsics"]
        camera = PinholeCamera(
            width_px=int(data["width"]),
            height_px=int(data["height"]),
            **{f"{name}_px": float(intrinsics[name]) for name in ("fx", "fy", "cx", "cy")},
        )
        return camera, [_read_object(fields) for fields in document["objects"]]
    except KeyError as error:
        raise PipelineError(f"{source}: no field {error}; DOPE's labels have it") from error
    except (TypeError, ValueError) as error:
        raise PipelineError(
            f"{source}: a field is of another shape than in DOPE's labels ({error})"
        ) from error


def _read_object(fields: Mapping[str, Any]) -> DopeObject:
    points = list(fields["projected_cuboid"])
    if len(points) == 8:
        points.append(fields["projected_cuboid_centroid"])
    uv_px = np.array(points, np.float64).reshape(9, 2)
    uv_px[(uv_px == ABSENT_PX).all(axis=1)] = np.nan
    T_c_o = None
    if "location" in fields and "quaternion_xyzw" in fields:
        T_c_o = np.eye(4)
        T_c_o[:3, :3] = Rotation.from_quat(fields["quaternion_xyzw"]).as_matrix()
        T_c_o[:3, 3] = np.array(fields["location"], np.float64) / CM_PER_M
    return DopeObject(
        class_name=str(fields["class"]),
        visibility=float(fields["visibility"]),
        projected_cuboid_px=uv_px,
        T_c_o=T_c_o,
    )
