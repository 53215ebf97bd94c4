"""The cuboid around an object: its nine points in DOPE's order, their pixels, and the pose from them."""

from __future__ import annotations

import cv2
import numpy as np

from rendezvous.geometry.camera import PinholeCamera
from rendezvous.geometry.se2 import Array

Vec3 = tuple[float, float, float]

CUBOID_CORNER_SIGNS: tuple[tuple[int, int, int], ...] = (
    (+1, -1, +1),
    (-1, -1, +1),
    (-1, +1, +1),
    (+1, +1, +1),
    (+1, -1, -1),
    (-1, -1, -1),
    (-1, +1, -1),
    (+1, +1, -1),
    (0, 0, 0),
)
"""DOPE's order: point i lies at signs · half sides along the axes x, y, z of o; the centroid is last."""


def cuboid_points(size_m: Vec3) -> Array:
    """(9, 3) [m] in o: the corners in DOPE's order, then the centroid."""
    return 0.5 * np.array(CUBOID_CORNER_SIGNS, np.float64) * np.array(size_m)


def project_cuboid(T_c_o: Array, size_m: Vec3, camera: PinholeCamera) -> Array:
    """(9, 2) [px]: the nine points' pixels, inside the image or not; NaN for points behind the camera."""
    return camera.project(cuboid_points(size_m) @ T_c_o[:3, :3].T + T_c_o[:3, 3])


def pose_from_cuboid(uv_px: Array, size_m: Vec3, camera: PinholeCamera) -> Array | None:
    """(4, 4) `T_c_o` whose cuboid projects to the points: perspective-n-point over those that are known.

    SQPnP, then least squares on the pixels. (DOPE's solver is EPnP alone, which fails more often with fewer
    points.) Four corners of one plane through the centroid are ambiguous: two poses fit them.

    Args:
        uv_px: (9, 2) in DOPE's order; NaN for unknown points.
        size_m: sides along the axes of o.
        camera: intrinsics.

    Returns:
        None if fewer than four points are known, they all lie in one place, or no pose puts the cuboid in
        front of the camera.
    """
    known = np.isfinite(uv_px).all(axis=1)
    if known.sum() < 4:
        return None
    p_o, uv, K = cuboid_points(size_m)[known], np.ascontiguousarray(uv_px[known]), camera.K()
    try:
        found, rvec, tvec = cv2.solvePnP(p_o, uv, K, None, flags=cv2.SOLVEPNP_SQPNP)
    except cv2.error:  # the points lie in one place
        return None
    if not found:
        return None
    rvec, tvec = cv2.solvePnPRefineLM(p_o, uv, K, None, rvec, tvec)
    T_c_o = np.eye(4)
    T_c_o[:3, :3] = cv2.Rodrigues(rvec)[0]
    T_c_o[:3, 3] = tvec.ravel()
    return T_c_o if np.isfinite(T_c_o).all() and T_c_o[2, 3] > 0.0 else None
