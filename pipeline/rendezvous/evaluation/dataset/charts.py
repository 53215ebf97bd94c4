"""Charts of distributions."""

from __future__ import annotations

import numpy as np

from rendezvous.evaluation.pictures.canvas import BLUE, INK, MUTED, RED, Canvas
from rendezvous.geometry.camera import Image
from rendezvous.geometry.se2 import Array

_WIDTH_PX, _HEIGHT_PX = 1240, 460
_LEFT_PX, _TOP_PX, _BOTTOM_PX = 28, 70, 60


def histogram(values: Array, edges: Array, *, title: str, mark: float, mark_label: str) -> Image:
    """Bars of how many values (N,) fall between neighbouring edges (B + 1,), and a marked value.

    Returns:
        (H, W, 3) uint8 RGB.
    """
    counts, _ = np.histogram(values, edges)
    canvas = Canvas(_WIDTH_PX, _HEIGHT_PX)
    canvas.text(title, _LEFT_PX, 40, size_px=25, bold=True)
    base_px, step_px = _HEIGHT_PX - _BOTTOM_PX, (_WIDTH_PX - 2 * _LEFT_PX) / len(counts)
    px_per_count = (base_px - _TOP_PX - 50) / max(int(counts.max()), 1)
    for i, count in enumerate(counts):
        left_px, right_px = _LEFT_PX + i * step_px + 2, _LEFT_PX + (i + 1) * step_px - 2
        top_px = base_px - count * px_per_count
        corners = [[left_px, base_px], [left_px, top_px], [right_px, top_px], [right_px, base_px]]
        canvas.polygon(np.array(corners), colour=BLUE)
        canvas.text(str(count), left_px, top_px - 8, size_px=17, colour=MUTED)
    for i, edge in enumerate(edges[::2]):
        canvas.text(f"{edge:.1f}", _LEFT_PX + 2 * i * step_px - 12, base_px + 28, size_px=18)
    canvas.polyline(np.array([[_LEFT_PX, base_px], [_WIDTH_PX - _LEFT_PX, base_px]]), colour=INK, width_px=2)
    mark_px = _LEFT_PX + (mark - edges[0]) / (edges[-1] - edges[0]) * (_WIDTH_PX - 2 * _LEFT_PX)
    canvas.dashes(np.array([[mark_px, _TOP_PX], [mark_px, base_px]]), colour=RED, width_px=2)
    canvas.text(mark_label, mark_px + 8, _TOP_PX + 14, size_px=18, colour=RED)
    return canvas.image
