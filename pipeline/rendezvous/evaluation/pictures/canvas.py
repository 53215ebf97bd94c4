"""A picture to draw on, in pixels or, through a `View`, in metres. RGB, uint8."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from rendezvous.geometry.camera import Image
from rendezvous.geometry.se2 import Array

Colour = tuple[int, int, int]

SHEET_WIDTH_PX = 1480
"""Width of a sheet. It is read at less than that, and so stays sharp on dense displays."""

SHEET_MARGIN_PX = 28

INK: Colour = (38, 40, 46)
MUTED: Colour = (118, 122, 130)
PAPER: Colour = (255, 255, 255)
UNSEEN: Colour = (229, 231, 235)
RED: Colour = (203, 36, 49)
BLUE: Colour = (28, 92, 190)

_FONT = cv2.FontFace("sans")
_REGULAR, _BOLD = 400, 700
_SUBPIXEL_BITS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """Where a frame's metres land on a picture; x goes right, y goes up."""

    px_per_m: float
    # u0_px, v0_px: pixel of the frame's origin.
    u0_px: float
    v0_px: float

    def uv_px(self, p_m: Array) -> Array:
        """(N, 2) pixels of points (N, 2) [m]."""
        return np.array([self.u0_px, self.v0_px]) + p_m * (self.px_per_m, -self.px_per_m)

    def p_m(self, uv_px: Array) -> Array:
        """Points (..., 2) [m] of pixels (..., 2); the inverse of `uv_px`."""
        return (uv_px - (self.u0_px, self.v0_px)) / (self.px_per_m, -self.px_per_m)


def fitted_view(
    lower_m: Array, upper_m: Array, *, px_per_m: float, centre_uv_px: tuple[float, float]
) -> View:
    """The view that puts the middle of the box between two corners (2,) [m] at a pixel."""
    x_m, y_m = (lower_m + upper_m) / 2.0
    return View(
        px_per_m=px_per_m,
        u0_px=float(centre_uv_px[0] - x_m * px_per_m),
        v0_px=float(centre_uv_px[1] + y_m * px_per_m),
    )


class Canvas:
    """A picture that is drawn on in place."""

    def __init__(self, width_px: int, height_px: int, colour: Colour = PAPER) -> None:
        self.image: Image = np.full((height_px, width_px, 3), colour, np.uint8)

    def text(
        self,
        words: str,
        u_px: float,
        v_px: float,
        *,
        size_px: int,
        colour: Colour = INK,
        bold: bool = False,
        right: bool = False,
    ) -> float:
        """Writes a line of text and returns the u where it ends.

        Its baseline starts at the pixel, or ends there if aligned to the `right`.
        """
        width_px = text_width_px(words, size_px=size_px, bold=bold)
        start_px = u_px - width_px if right else u_px
        at = (round(start_px), round(v_px))
        cv2.putText(self.image, words, at, colour, _FONT, size_px, _BOLD if bold else _REGULAR)
        return start_px + width_px

    def polyline(self, uv_px: Array, *, colour: Colour, width_px: int = 1, closed: bool = False) -> None:
        """Draws a smooth line through pixels (N, 2)."""
        points = np.round(uv_px * 2**_SUBPIXEL_BITS).astype(np.int32)
        cv2.polylines(self.image, [points], closed, colour, width_px, cv2.LINE_AA, _SUBPIXEL_BITS)

    def dashes(self, uv_px: Array, *, colour: Colour, width_px: int = 1, dash_px: float = 6.0) -> None:
        """Draws a dashed line between two pixels (2, 2)."""
        length_px = float(np.linalg.norm(uv_px[1] - uv_px[0]))
        cuts = np.linspace(0.0, 1.0, 2 * max(round(length_px / (2 * dash_px)), 1) + 2)
        for a, b in zip(cuts[:-1:2], cuts[1::2], strict=True):
            self.polyline(uv_px[0] + np.outer((a, b), uv_px[1] - uv_px[0]), colour=colour, width_px=width_px)

    def polygon(self, uv_px: Array, *, colour: Colour, opacity: float = 1.0) -> None:
        """Fills a simple polygon of pixels (N, 2)."""
        self.rings([uv_px], colour=colour, opacity=opacity)

    def rings(self, rings_px: list[Array], *, colour: Colour, opacity: float = 1.0) -> None:
        """Fills what an odd number of rings encloses, such as an outline without its holes."""
        drawn = self.image.copy()
        points = [np.round(ring * 2**_SUBPIXEL_BITS).astype(np.int32) for ring in rings_px]
        cv2.fillPoly(drawn, points, colour, cv2.LINE_AA, _SUBPIXEL_BITS)
        cv2.addWeighted(drawn, opacity, self.image, 1.0 - opacity, 0.0, dst=self.image)

    def disc(self, uv_px: Array, *, radius_px: float, colour: Colour, outline: Colour = PAPER) -> None:
        """Fills a circle around a pixel (2,), with an outline one pixel wide."""
        scale = 2**_SUBPIXEL_BITS
        at = (round(uv_px[0] * scale), round(uv_px[1] * scale))
        radius = round(radius_px * scale)
        cv2.circle(self.image, at, radius + scale, outline, -1, cv2.LINE_AA, _SUBPIXEL_BITS)
        cv2.circle(self.image, at, radius, colour, -1, cv2.LINE_AA, _SUBPIXEL_BITS)

    def scale_bar(self, u_px: float, v_px: float, *, px_per_m: float, longest_px: float) -> None:
        """Draws the longest bar of 1, 2, 5, 10, 20 or 50 m that fits, from a pixel to the right."""
        metres = max((m for m in (1, 2, 5, 10, 20, 50) if m * px_per_m <= longest_px), default=1)
        end_px = u_px + metres * px_per_m
        self.polyline(np.array([[u_px, v_px], [end_px, v_px]]), colour=INK, width_px=2)
        for u in (u_px, end_px):
            self.polyline(np.array([[u, v_px - 5], [u, v_px + 5]]), colour=INK, width_px=2)
        self.text(f"{metres} m", end_px + 8, v_px + 6, size_px=17)

    def paste(self, image: Image, u_px: int, v_px: int) -> None:
        """Puts a picture's upper left corner at a pixel."""
        self.image[v_px : v_px + image.shape[0], u_px : u_px + image.shape[1]] = image


def titled(width_px: int, height_px: int, title: str, subtitle: str, *, baseline_px: int = 48) -> Canvas:
    """The head of a sheet, with its title and subtitle on one line."""
    canvas = Canvas(width_px, height_px)
    end_px = canvas.text(title, SHEET_MARGIN_PX, baseline_px, size_px=32, bold=True)
    canvas.text(subtitle, end_px + 18, baseline_px, size_px=20, colour=MUTED)
    return canvas


def in_columns(cells: Sequence[Image], *, width_px: int, columns: int, gap_px: int = 0) -> list[Image]:
    """Strips of a sheet with so many cells side by side; the last strip may have fewer."""
    strips = []
    for first in range(0, len(cells), columns):
        strip = Canvas(width_px, max(cell.shape[0] for cell in cells[first : first + columns]))
        for place, cell in enumerate(cells[first : first + columns]):
            strip.paste(cell, SHEET_MARGIN_PX + place * (cell.shape[1] + gap_px), 0)
        strips.append(strip.image)
    return strips


def text_width_px(words: str, *, size_px: int, bold: bool = False) -> int:
    """Width of a line of text."""
    return int(cv2.getTextSize((0, 0), words, (0, 0), _FONT, size_px, _BOLD if bold else _REGULAR)[2])


def shortened(name: str, most: int) -> str:
    """The name, cut to `most` characters with an ellipsis if it is longer."""
    return name if len(name) <= most else f"{name[: most - 1]}…"


def encoded_png(image: Image) -> bytes:
    """The picture as a PNG, filtered or not, whichever is smaller."""
    # Drawings with few flat colours are a quarter smaller unfiltered, photographs a third smaller filtered.
    unfiltered = [cv2.IMWRITE_PNG_COMPRESSION, 9, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE]
    filtered = [cv2.IMWRITE_PNG_COMPRESSION, 6, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_ALL_FILTERS]
    encoded = [cv2.imencode(".png", image[..., ::-1], options) for options in (unfiltered, filtered)]
    assert all(ok for ok, _ in encoded)
    return min((bytes(data.tobytes()) for _, data in encoded), key=len)
