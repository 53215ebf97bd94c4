"""Hough spectrum: headings from the directions of walls, then shifts from the maps' profiles.

Carpin, "Fast and accurate map merging for multi-robot systems", Autonomous Robots 25 (2008). The lines of a
map's Hough transform, squared and summed over their distance, give its spectrum over direction; turning a map
shifts its spectrum. Each peak of the two spectra's circular correlation proposes a heading; for each the
profiles of both maps along x and y give the shift. The proposal under which the maps agree best is kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import affine_transform
from skimage.transform import hough_line

from rendezvous.alignment.estimate import Estimate
from rendezvous.alignment.window import OCCUPIED_CELL, UNKNOWN_CELL, MapWindow, SearchRange
from rendezvous.geometry.occupancy_grid import Cells
from rendezvous.geometry.se2 import SE2, Array, wrap_angle


@dataclass(frozen=True, slots=True, kw_only=True)
class HoughSpectrum:
    """Carpin's method over all headings and shifts, or only over those of a range.

    Attributes:
        search: half widths; None for every heading and shift, as published.
        directions: bins of the spectrum over the full turn, which it fills twice; even.
        candidates: number of headings to try, the best of the correlation's strict maxima.
        robust_rad: headings this far on either side of each candidate are tried too; 0 for the plain method.
    """

    search: SearchRange | None = None
    directions: int = 360
    candidates: int = 4
    robust_rad: float = math.radians(1.0)

    @property
    def name(self) -> str:
        """The method's name in tables, which tells the two apart."""
        return "Hough spectrum" if self.search is None else "Hough spectrum, in range"

    def __call__(self, window: MapWindow) -> Estimate:
        """The frame error; a failure without walls, without a heading in the range, or if no cells agree."""
        # (P, 2) [m] in v, the centres of the walls' cells.
        walls = (np.argwhere(cells == OCCUPIED_CELL)[:, ::-1].astype(np.float64) for cells in window.cells)
        walls_0, walls_1 = ((wall + 0.5 - 0.5 * window.cells.shape[-1]) * window.cell_m for wall in walls)
        for channel, walls_m in enumerate((walls_0, walls_1)):
            if len(walls_m) == 0:
                return Estimate(theta=None, reason=f"map {channel} has no walls in the window")
        spectrum_0, spectrum_1 = (self._spectrum(cells) for cells in window.cells)
        headings_rad = self._headings(spectrum_0, spectrum_1)
        if not headings_rad:
            return Estimate(theta=None, reason="the spectra agree at no heading in the range")
        axis_rad = float(spectrum_0.argmax()) * 2.0 * math.pi / self.directions
        tried = [self._shifted(walls_0, walls_1, yaw_rad, axis_rad, window) for yaw_rad in headings_rad]
        agreed, theta = max(((agreement(window, theta), theta) for theta in tried), key=lambda pair: pair[0])
        if agreed == 0.0:
            return Estimate(theta=None, reason="no motion that was tried lets both maps agree on any cell")
        return Estimate(theta=theta.wrapped())

    def _spectrum(self, cells: Cells) -> Array:
        """(directions,) sum over distance of the squared Hough transform, normalised to a sum of 1."""
        half_turn = np.arange(self.directions // 2) * 2.0 * math.pi / self.directions
        lines, _, _ = hough_line(cells == OCCUPIED_CELL, half_turn)
        spectrum = np.square(lines.astype(np.float64)).sum(axis=0)
        return np.tile(spectrum, 2) / (2.0 * spectrum.sum())

    def _headings(self, spectrum_0: Array, spectrum_1: Array) -> list[float]:
        """Headings by which map 1 is turned against map 0, the most likely first, each with those beside
        it."""
        transform = np.fft.rfft(spectrum_1) * np.fft.rfft(spectrum_0).conj()
        # Rounded, so that the correlation's two equal halves stay equal.
        correlation = np.fft.irfft(transform, self.directions).round(12)
        peaks = (correlation > np.roll(correlation, 1)) & (correlation > np.roll(correlation, -1))
        bins = np.flatnonzero(peaks)
        bins = bins[np.argsort(-correlation[bins], kind="stable")]
        headings = [wrap_angle(float(b) * 2.0 * math.pi / self.directions) for b in bins]
        if self.search is not None:
            headings = [heading for heading in headings if abs(heading) <= self.search.yaw_rad + 1e-9]
        beside = (0.0, self.robust_rad, -self.robust_rad) if self.robust_rad > 0.0 else (0.0,)
        return [heading + turn for heading in headings[: self.candidates] for turn in beside]

    def _shifted(
        self, walls_0: Array, walls_1: Array, yaw_rad: float, axis_rad: float, window: MapWindow
    ) -> SE2:
        """θ at a heading: the shift along and across map 0's main walls that matches the profiles best."""
        to_axes = SE2(0.0, 0.0, -axis_rad)
        p_0, p_1 = to_axes @ walls_0, to_axes @ (SE2(0.0, 0.0, -yaw_rad) @ walls_1)
        limit_m = math.inf if self.search is None else self.search.xy_m
        back_m = np.array([_profile_shift(p_1[:, i], p_0[:, i], window.cell_m, limit_m) for i in (0, 1)])
        back = to_axes.inverse() @ back_m
        return SE2(float(back[0]), float(back[1]), -yaw_rad).inverse()


def agreement(window: MapWindow, theta: SE2) -> float:
    """Carpin's acceptance index: agreeing cells / cells known in both maps, once θ is undone; 0 for none."""
    cells_0, cells_1 = window.cells
    c, s = math.cos(theta.yaw_rad), math.sin(theta.yaw_rad)
    R_rows_cols = np.array([[c, s], [-s, c]])
    middle = np.full(2, 0.5 * len(cells_0) - 0.5)
    offset = middle - R_rows_cols @ middle + np.array([theta.y_m, theta.x_m]) / window.cell_m
    undone_1 = affine_transform(cells_1, R_rows_cols, offset, order=0, cval=UNKNOWN_CELL)
    both = (cells_0 != UNKNOWN_CELL) & (undone_1 != UNKNOWN_CELL)
    return float((cells_0 == undone_1)[both].mean()) if both.any() else 0.0


def _profile_shift(moving_m: Array, fixed_m: Array, cell_m: float, limit_m: float) -> float:
    """The shift [m] of one set of coordinates that brings its histogram closest to the other's."""
    first = min(moving_m.min(), fixed_m.min())
    bins = math.floor((max(moving_m.max(), fixed_m.max()) - first) / cell_m) + 1
    moving, fixed = (
        np.bincount(((p - first) / cell_m).astype(np.int64), minlength=bins).astype(np.float64)
        for p in (moving_m, fixed_m)
    )
    shifts_m = (np.arange(2 * bins - 1) - (bins - 1)) * cell_m
    match = np.where(np.abs(shifts_m) <= limit_m + 1e-9, np.correlate(fixed, moving, mode="full"), -1.0)
    return float(shifts_m[match.argmax()])
