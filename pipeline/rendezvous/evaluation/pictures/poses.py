"""Pictures of the robot as a camera sees it, with its label on top: cuboid, heading, box."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from rendezvous.errors import PipelineError
from rendezvous.evaluation.pictures.canvas import (
    MUTED,
    PAPER,
    SHEET_MARGIN_PX,
    SHEET_WIDTH_PX,
    Canvas,
    Colour,
    in_columns,
    shortened,
    titled,
)
from rendezvous.geometry.camera import Image
from rendezvous.geometry.cuboid import CUBOID_CORNER_SIGNS
from rendezvous.geometry.se2 import Array

CUBOID_COLOUR: Colour = (0, 214, 255)
FRONT_COLOUR: Colour = (255, 140, 0)
BOX_COLOUR: Colour = (250, 250, 250)

_COLUMNS, _GAP_PX = 4, 16
_HEADER_PX, _CAPTION_PX = 112, 46
_DOT_PX, _LINE_PX, _FRAME_PX = 3.0, 1, 3
_SMALL_SHARE, _INSET_SHARE, _INSET_MARGIN, _LEAST_CROP_PX = 0.25, 0.42, 1.5, 24
"""The square around the robot, enlarged by a margin, is magnified if it is a small share of the image."""
_BEYOND_PX = 9.0
"""How far lines go on beyond the image, so that their ends do not show."""

_CORNERS = CUBOID_CORNER_SIGNS[:8]
_EDGES = tuple(
    (i, j)
    for i, a in enumerate(_CORNERS)
    for j, b in enumerate(_CORNERS[:i])
    if sum(p != q for p, q in zip(a, b, strict=True)) == 1
)
_FRONT = frozenset(i for i, (x, _, _) in enumerate(_CORNERS) if x > 0)
_CENTROID = 8


def pose_sheet(rows: Sequence[Mapping[str, Any]], *, title: str, subtitle: str = "") -> Image:
    """A sheet of images, four to a line, each with its label drawn on it and described below.

    Args:
        rows: rows of `POSES.rows`, `VIEWS.rows` or `PAIRS.rows`, each with an image.
        title, subtitle: first line of the sheet.

    Returns:
        (H, SHEET_WIDTH_PX, 3) uint8 RGB.

    Raises:
        PipelineError: an image cannot be decoded.
    """
    header = titled(SHEET_WIDTH_PX, _HEADER_PX, title, subtitle)
    draw_label_legend(header, SHEET_MARGIN_PX, 86)
    width_px = (SHEET_WIDTH_PX - 2 * SHEET_MARGIN_PX - (_COLUMNS - 1) * _GAP_PX) // _COLUMNS
    cells = [_cell(row, width_px) for row in rows]
    lines = in_columns(cells, width_px=SHEET_WIDTH_PX, columns=_COLUMNS, gap_px=_GAP_PX)
    return np.concatenate([header.image, *lines, Canvas(SHEET_WIDTH_PX, SHEET_MARGIN_PX // 2).image])


def labelled_image(row: Mapping[str, Any], *, width_px: int) -> Image:
    """A row's image, scaled, with its label drawn on it: cuboid, front, centroid, box.

    A robot so small that the lines would hide it is shown magnified in a corner as well.

    Raises:
        PipelineError: the image cannot be decoded.
    """
    image = _decoded(row)
    scale = width_px / image.shape[1]
    canvas = Canvas(width_px, round(image.shape[0] * scale))
    canvas.image[:] = cv2.resize(image, canvas.image.shape[1::-1], interpolation=cv2.INTER_AREA)
    square = _square_around_small(row, image.shape)
    if square is None:
        _draw_label(canvas, row, scale=scale)
    else:
        _draw_edges(canvas, _scaled(row["projected_cuboid_px"], scale))
        _draw_inset(canvas, image, row, *square)
    return canvas.image


def image_with_cuboid(image: Image, uv_px: Array) -> Image:
    """A picture with a cuboid drawn on it: its edges, its front, its centroid.

    Args:
        image: (H, W, 3) uint8 RGB.
        uv_px: (9, 2) the cuboid's points in DOPE's order, NaN where unknown.
    """
    canvas = Canvas(image.shape[1], image.shape[0])
    canvas.image[:] = image
    _draw_label(canvas, {"box_px": None, "projected_cuboid_px": uv_px}, scale=1.0)
    return canvas.image


def visibility_words(row: Mapping[str, Any]) -> str:
    """How much of the robot is visible, in words."""
    return "no robot" if row["T_c_o"] is None else f"{row['visibility']:.0%} visible"


def draw_label_legend(canvas: Canvas, u_px: float, v_px: float) -> float:
    """Writes on one line what the lines on an image stand for; returns the u where it ends."""
    for colour, width_px, name in (
        (FRONT_COLOUR, 4, "the robot's front"),
        (CUBOID_COLOUR, 4, "its cuboid"),
        (MUTED, 2, "box of its visible pixels"),
    ):
        canvas.polyline(np.array([[u_px, v_px - 6], [u_px + 34, v_px - 6]]), colour=colour, width_px=width_px)
        u_px = canvas.text(name, u_px + 42, v_px, size_px=19) + 28
    return u_px


def _decoded(row: Mapping[str, Any]) -> Image:
    image = cv2.imdecode(np.frombuffer(row["image"], np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        name = row.get("pose_id") or row.get("pair_id")
        raise PipelineError(f"{name}: its image cannot be decoded; must be JPEG or PNG")
    return np.asarray(image[..., ::-1], dtype=np.uint8)


def _scaled(uv_px: Array, scale: float) -> Array:
    """The pixels of a scaled image, in which (0, 0) is the centre of the first pixel, not its corner."""
    return (uv_px + 0.5) * scale - 0.5


def _square_around_small(
    row: Mapping[str, Any], shape: tuple[int, ...]
) -> tuple[NDArray[np.int64], int] | None:
    """Corner (2,) and side [px] of the square around a robot that is visible and small, else None."""
    uv_px = row["projected_cuboid_px"]
    if uv_px is None or row["box_px"] is None or not np.isfinite(uv_px).all():
        return None
    height_px, width_px = shape[:2]
    side_px = max(round(_INSET_MARGIN * np.ptp(uv_px, axis=0).max()), _LEAST_CROP_PX)
    if side_px > _SMALL_SHARE * min(height_px, width_px):
        return None
    corner_px = np.round((uv_px.min(axis=0) + uv_px.max(axis=0) - side_px) / 2.0)
    return corner_px.clip(0, (width_px - side_px, height_px - side_px)).astype(np.int64), side_px


def _draw_inset(
    canvas: Canvas, image: Image, row: Mapping[str, Any], corner_px: NDArray[np.int64], side_px: int
) -> None:
    """Draws a square of the image, magnified and with the label, in the corner farthest from it."""
    height_px, width_px = canvas.image.shape[:2]
    u_px, v_px = corner_px
    inset_px = round(_INSET_SHARE * height_px)
    inset = Canvas(inset_px, inset_px)
    crop = np.ascontiguousarray(image[v_px : v_px + side_px, u_px : u_px + side_px])
    inset.image[:] = cv2.resize(crop, (inset_px, inset_px), interpolation=cv2.INTER_CUBIC)
    _draw_label(inset, row, scale=inset_px / side_px, corner_px=corner_px)
    framed_px = inset_px + _FRAME_PX
    at_u = 0 if u_px + side_px / 2.0 > image.shape[1] / 2.0 else width_px - inset_px
    at_v = 0 if v_px + side_px / 2.0 > image.shape[0] / 2.0 else height_px - inset_px
    canvas.image[max(at_v - _FRAME_PX, 0) :][:framed_px, max(at_u - _FRAME_PX, 0) :][:, :framed_px] = PAPER
    canvas.paste(inset.image, at_u, at_v)


def _draw_label(
    canvas: Canvas, row: Mapping[str, Any], *, scale: float, corner_px: NDArray[np.int64] | int = 0
) -> None:
    """Draws box, cuboid, centroid and the line from there to the front's middle.

    The canvas shows the part of the image from `corner_px` on, magnified by `scale`.
    """
    if row["box_px"] is not None:
        (u0, v0), (u1, v1) = _scaled(row["box_px"].reshape(2, 2) - corner_px, scale)
        ring = np.array([[u0, v0], [u1, v0], [u1, v1], [u0, v1]])
        canvas.polyline(ring, colour=BOX_COLOUR, closed=True)
    if row["projected_cuboid_px"] is None:
        return
    uv_px = _scaled(row["projected_cuboid_px"] - corner_px, scale)
    _draw_edges(canvas, uv_px)
    centroid, front = uv_px[_CENTROID], uv_px[sorted(_FRONT)].mean(axis=0)
    _draw_clipped(canvas, centroid, front, FRONT_COLOUR)
    if _inside(canvas, centroid):
        canvas.disc(centroid, radius_px=_DOT_PX, colour=FRONT_COLOUR, outline=PAPER)


def _draw_edges(canvas: Canvas, uv_px: Array) -> None:
    """Draws the cuboid's edges between known corners, those of the front last."""
    for i, j in sorted(_EDGES, key=_FRONT.issuperset):
        colour = FRONT_COLOUR if _FRONT.issuperset((i, j)) else CUBOID_COLOUR
        _draw_clipped(canvas, uv_px[i], uv_px[j], colour)


def _inside(canvas: Canvas, uv_px: Array) -> bool:
    """Whether a pixel (2,) lies on the picture; an unknown one (NaN) does not."""
    height_px, width_px = canvas.image.shape[:2]
    return bool((uv_px >= 0.0).all() and (uv_px < (width_px, height_px)).all())


def _draw_clipped(canvas: Canvas, start_px: Array, end_px: Array, colour: Colour) -> None:
    """Draws the part of a line that lies on the image, nothing if an end is unknown (NaN).

    A point near the camera's plane lies so far outside that OpenCV's fixed-point pixels would overflow.
    """
    if not np.isfinite([start_px, end_px]).all():
        return
    height_px, width_px = canvas.image.shape[:2]
    step_px = end_px - start_px
    # Liang and Barsky 1984: where the line, start + t step, crosses the borders; NaN along a border.
    with np.errstate(divide="ignore", invalid="ignore"):
        t_low = (-_BEYOND_PX - start_px) / step_px
        t_high = (np.array([width_px, height_px]) + _BEYOND_PX - start_px) / step_px
    enters = np.fmax.reduce([0.0, *np.minimum(t_low, t_high)])
    leaves = np.fmin.reduce([1.0, *np.maximum(t_low, t_high)])
    if enters < leaves:
        ends_px = start_px + np.outer((enters, leaves), step_px)
        canvas.polyline(ends_px, colour=colour, width_px=_LINE_PX)


def _cell(row: Mapping[str, Any], width_px: int) -> Image:
    image = labelled_image(row, width_px=width_px)
    canvas = Canvas(width_px, image.shape[0] + _CAPTION_PX)
    canvas.paste(image, 0, 0)
    v_px = image.shape[0] + 24
    end_px = canvas.text(visibility_words(row), 0, v_px, size_px=18, bold=True)
    if row["T_c_o"] is not None:
        canvas.text(f"at {np.linalg.norm(row['T_c_o'][:3, 3]):.2f} m", end_px + 8, v_px, size_px=18)
    name = row.get("mode") or shortened(row["plan_id"], 12)
    canvas.text(name, width_px, v_px, size_px=18, colour=MUTED, right=True)
    return canvas.image
