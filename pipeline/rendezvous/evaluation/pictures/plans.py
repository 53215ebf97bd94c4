"""Pictures of floor plans: free space, furniture, rooms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rendezvous.evaluation.pictures.canvas import (
    INK,
    MUTED,
    PAPER,
    SHEET_MARGIN_PX,
    UNSEEN,
    Canvas,
    Colour,
    View,
    fitted_view,
    in_columns,
    shortened,
    text_width_px,
    titled,
)
from rendezvous.floorplan.records import Floorplan, Shape, Solid
from rendezvous.geometry.camera import Image
from rendezvous.geometry.se2 import Array

_COLUMNS = 4
_CELL_WIDTH_PX, _CELL_HEIGHT_PX, _CAPTION_PX = 420, 330, 58
_TITLE_PX = 84
_FURNITURE: Colour = (214, 188, 150)
_FURNITURE_EDGE: Colour = (150, 120, 80)
_CIRCLE = np.stack([np.cos(np.linspace(0, 2 * np.pi, 33)), np.sin(np.linspace(0, 2 * np.pi, 33))], axis=1)

FurnishedPlan = tuple[Floorplan, Sequence[Solid]]


def plan_sheet(plans: Sequence[FurnishedPlan], *, title: str, subtitle: str = "") -> Image:
    """A grid of floor plans with their furniture, each at its own scale.

    Returns:
        (H, W, 3) uint8 RGB.
    """
    width_px = _COLUMNS * _CELL_WIDTH_PX + 2 * SHEET_MARGIN_PX
    header = titled(width_px, _TITLE_PX, title, subtitle, baseline_px=52).image
    cells = [_cell(plan, solids) for plan, solids in plans]
    return np.concatenate([header, *in_columns(cells, width_px=width_px, columns=_COLUMNS)])


def _cell(plan: Floorplan, solids: Sequence[Solid]) -> Image:
    canvas = Canvas(_CELL_WIDTH_PX, _CELL_HEIGHT_PX + _CAPTION_PX)
    lower, upper = plan.outline_m.min(axis=0), plan.outline_m.max(axis=0)
    px_per_m = min((_CELL_WIDTH_PX - 30) / (upper - lower)[0], (_CELL_HEIGHT_PX - 30) / (upper - lower)[1])
    centre_px = (_CELL_WIDTH_PX / 2.0, _CELL_HEIGHT_PX / 2.0)
    view = fitted_view(lower, upper, px_per_m=px_per_m, centre_uv_px=centre_px)
    frame = np.array([[5, 5], [5, _CELL_HEIGHT_PX - 5], [415, _CELL_HEIGHT_PX - 5], [415, 5]])
    canvas.polygon(frame.astype(np.float64), colour=UNSEEN)
    rings_px = [view.uv_px(ring) for ring in (plan.outline_m, *plan.holes_m)]
    canvas.rings(rings_px, colour=PAPER)
    for solid in solids:
        footprint_px = view.uv_px(_footprint_m(solid))
        canvas.polygon(footprint_px, colour=_FURNITURE)
        canvas.polyline(footprint_px, colour=_FURNITURE_EDGE, closed=True)
    for ring_px in rings_px:
        canvas.polyline(ring_px, colour=INK, width_px=2, closed=True)
    _label_rooms(canvas, plan, view)
    canvas.text(shortened(plan.plan_id, 26), 8, _CELL_HEIGHT_PX + 22, size_px=18, bold=True)
    canvas.scale_bar(_CELL_WIDTH_PX - 160, _CELL_HEIGHT_PX + 16, px_per_m=px_per_m, longest_px=100)
    return canvas.image


def _footprint_m(solid: Solid) -> Array:
    return solid.T_w_s() @ (_CIRCLE * solid.half_x_m) if solid.shape is Shape.CYLINDER else solid.corners_m()


def _label_rooms(canvas: Canvas, plan: Floorplan, view: View) -> None:
    """Writes names into the rooms that are wide enough."""
    for room in plan.rooms:
        corners_px = view.uv_px(np.array(room.box_m).reshape(2, 2))
        name = room.category.replace("_", " ").lower()
        width_px = text_width_px(name, size_px=15)
        if abs(corners_px[1, 0] - corners_px[0, 0]) > width_px + 8:
            u_px, v_px = corners_px.mean(axis=0)
            canvas.text(name, u_px - width_px / 2.0, v_px + 5, size_px=15, colour=MUTED)
