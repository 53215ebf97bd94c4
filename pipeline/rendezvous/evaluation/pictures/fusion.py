"""Pictures of a fusion: both maps over each other where it puts them, and the images with the robot found."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import chdtri, fdtri

from rendezvous.evaluation.pictures.canvas import (
    BLUE,
    INK,
    MUTED,
    PAPER,
    RED,
    Canvas,
    Colour,
    View,
    fitted_view,
)
from rendezvous.evaluation.pictures.map_panels import BOTH, blended, bounds_m, draw_robot, sampled
from rendezvous.evaluation.pictures.poses import image_with_cuboid
from rendezvous.fusion.fusion_input import FusionInput
from rendezvous.fusion.system import FusionResult
from rendezvous.geometry.camera import Image, PinholeCamera
from rendezvous.geometry.cuboid import Vec3, project_cuboid
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.pose_estimation.pose_estimate import RelativePose

LONGER_PX, LEAST_PX, MOST_PX_PER_M = 1200, 700, 80.0
"""The picture's longer side, its least width, and the largest scale, which small maps get."""

_MARGIN_M = 0.5
_HEADER_PX, _CAPTION_PX, _EDGE_PX = 92, 36, 18
_ELLIPSE_PROBABILITY = 0.95
_TURNS_RAD = np.linspace(0.0, 2.0 * math.pi, 72, endpoint=False)
_CIRCLE = np.stack([np.cos(_TURNS_RAD), np.sin(_TURNS_RAD)], axis=1)
_MEETING: Colour = (245, 160, 20)
_GOOD: Colour = (20, 120, 60)


def fusion_picture(meeting: FusionInput, result: FusionResult) -> Image:
    """Map 0 in red, map 1 in blue where T̂ puts it, walls of both in violet, and both robots.

    The ellipse holds robot 1 with 95 % probability by the fusion's covariance. The cross is where the
    sighting alone puts robot 1.

    Returns:
        (H, W, 3) uint8 RGB, along the axes of m0.
    """
    view, size_px = view_of_both(meeting, result.T_m0_m1)
    placed = ((meeting.grid_0, SE2.identity()), (meeting.grid_1, result.T_m0_m1))
    panel = Canvas(*size_px)
    panel.image[:] = blended([sampled(grid, T_m0_m, view, size_px) for grid, T_m0_m in placed])
    _draw_meeting(panel, view, meeting, result)
    panel.scale_bar(_EDGE_PX, size_px[1] - _EDGE_PX, px_per_m=view.px_per_m, longest_px=160)
    return np.concatenate([_header(size_px[0], result), panel.image])


def view_of_both(meeting: FusionInput, T_m0_m1: SE2) -> tuple[View, tuple[int, int]]:
    """A view of m0 that shows all known cells of both maps, and the panel's width and height [px]."""
    placed = ((meeting.grid_0, SE2.identity()), (meeting.grid_1, T_m0_m1))
    lower_m, upper_m = bounds_m(placed, _MARGIN_M)
    width_m, height_m = (float(extent_m) for extent_m in upper_m - lower_m)
    px_per_m = min(MOST_PX_PER_M, LONGER_PX / max(width_m, height_m))
    width_px, height_px = max(LEAST_PX, round(width_m * px_per_m)), round(height_m * px_per_m)
    centre_px = width_px / 2.0, height_px / 2.0
    return fitted_view(lower_m, upper_m, px_per_m=px_per_m, centre_uv_px=centre_px), (width_px, height_px)


def sighting_picture(image: Image, camera: PinholeCamera, pose: RelativePose, size_m: Vec3) -> Image:
    """An image with the cuboid of the most probable reading, and a caption: the pose, or why there is none.

    Args:
        image: (H, W, 3) uint8 RGB, undistorted.
        camera: of the image.
        pose: as estimated from the image.
        size_m: sides of the robot's cuboid.
    """
    if pose.found:
        at = pose.best.T_r0_r1
        words = (
            f"found, score {pose.score:.2f}: x {at.x_m:.2f} m, y {at.y_m:.2f} m, "
            f"heading {math.degrees(at.yaw_rad):.0f}°"
        )
        image = image_with_cuboid(image, project_cuboid(pose.best.T_c_o, size_m, camera))
    else:
        words = f"not found: {pose.reason}"
    caption = Canvas(image.shape[1], _CAPTION_PX)
    caption.text(words, 10, 25, size_px=18, colour=INK if pose.found else RED)
    return np.concatenate([image, caption.image])


def _draw_meeting(canvas: Canvas, view: View, meeting: FusionInput, result: FusionResult) -> None:
    T_m0_r1 = result.T_m0_m1 @ meeting.T_m1_r1
    robots_m = np.array([[T.x_m, T.y_m] for T in (meeting.T_m0_r0, T_m0_r1)])
    canvas.dashes(view.uv_px(robots_m), colour=INK)
    draw_robot(canvas, view, meeting.T_m0_r0, RED)
    draw_robot(canvas, view, T_m0_r1, BLUE)
    if result.covariance is not None:
        canvas.polyline(view.uv_px(_ellipse_m(result, T_m0_r1)), colour=_MEETING, width_px=2, closed=True)
    ((u, v),) = view.uv_px(np.array([[result.T_m0_v.x_m, result.T_m0_v.y_m]]))
    for du, dv in ((7.0, 7.0), (7.0, -7.0)):
        canvas.polyline(np.array([[u - du, v - dv], [u + du, v + dv]]), colour=_MEETING, width_px=2)


def _ellipse_m(result: FusionResult, T_m0_r1: SE2) -> Array:
    """(N, 2) [m] points of the ellipse around robot 1, in m0."""
    assert result.covariance is not None
    values, axes = np.linalg.eigh(result.covariance[:2, :2])
    sigmas = _ellipse_sigmas(result.degrees_of_freedom)
    return sigmas * _CIRCLE * np.sqrt(values) @ axes.T + (T_m0_r1.x_m, T_m0_r1.y_m)


def _ellipse_sigmas(degrees_of_freedom: float) -> float:
    """The ellipse's reach in standard deviations of a t distribution of two dimensions."""
    if math.isinf(degrees_of_freedom):
        return math.sqrt(chdtri(2, 1.0 - _ELLIPSE_PROBABILITY))
    nu = degrees_of_freedom
    return math.sqrt(2.0 * fdtri(2, nu, _ELLIPSE_PROBABILITY) * (nu - 2.0) / nu)


def _header(width_px: int, result: FusionResult) -> Image:
    canvas = Canvas(width_px, _HEADER_PX)
    verdict = "accepted" if result.verdict.accepted else "uncertain"
    colour = _GOOD if result.verdict.accepted else RED
    end_px = canvas.text("Fused map", _EDGE_PX, 40, size_px=28, bold=True)
    canvas.text(verdict, end_px + 14, 40, size_px=24, colour=colour, bold=True)
    share = result.after.wall_share
    agreement = "" if share is None else f"{share:.0%} of shared walls coincide"
    canvas.text(agreement, width_px - _EDGE_PX, 40, size_px=17, colour=MUTED, right=True)
    u_px = float(_EDGE_PX)
    for patch, words in ((RED, "map and robot 0"), (BLUE, "map and robot 1"), (BOTH, "walls of both")):
        canvas.disc(np.array([u_px + 6, 68]), radius_px=6, colour=patch, outline=PAPER)
        u_px = canvas.text(words, u_px + 18, 74, size_px=17) + 22
    canvas.polyline(np.array([[u_px, 62], [u_px + 12, 74]]), colour=_MEETING, width_px=2)
    canvas.polyline(np.array([[u_px, 74], [u_px + 12, 62]]), colour=_MEETING, width_px=2)
    u_px = canvas.text("seen here", u_px + 18, 74, size_px=17) + 22
    if result.covariance is not None:
        ring_px = _CIRCLE * (7.0, 5.0) + (u_px + 7, 68)
        canvas.polyline(ring_px, colour=_MEETING, width_px=2, closed=True)
        canvas.text(f"{_ELLIPSE_PROBABILITY:.0%}", u_px + 20, 74, size_px=17)
    return canvas.image
