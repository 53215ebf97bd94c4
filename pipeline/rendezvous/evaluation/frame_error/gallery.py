"""Fig. 6b of the paper: pairs as they truly lie, as methods saw them, and as each method places them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import pandas as pd

from rendezvous.alignment.frame_error import corrected
from rendezvous.alignment.window import OCCUPIED_CELL, UNKNOWN_CELL, MapWindow, map_window
from rendezvous.evaluation.frame_error.estimates import SUCCESS_M, SUCCESS_RAD
from rendezvous.evaluation.pictures.canvas import BLUE, INK, Canvas, Colour, View
from rendezvous.evaluation.pictures.map_panels import bounds_m, draw_robot, in_colours
from rendezvous.geometry.camera import Image
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.training.frame_error.pairs import MapPair, PerturbedPair

PANEL_PX = 420
_MARGIN_M = 0.5
_HEAT: Colour = (236, 122, 8)
_FULL_HEAT = 4.0
"""Multiple of its even share of attention at which a place has full colour."""


def chosen_pairs(reference: pd.DataFrame) -> list[tuple[str, int]]:
    """The best, the median and the worst pair of one method, and its median in the tenth of least overlap.

    Args:
        reference: the method's rows of an `outcome_table`.
    """
    by_error = reference["position_m"].sort_values(kind="stable").index
    least = reference["overlap"].sort_values(kind="stable").index[: max(1, len(reference) // 10)]
    low = reference["position_m"][least].sort_values(kind="stable").index
    return shown_once(
        {
            "best": by_error[:1],
            "median": by_error[len(by_error) // 2 :][:1],
            "low overlap": low[len(low) // 2 :][:1],
            "worst": by_error[-1:],
        }
    )


def shown_once(named: Mapping[str, Iterable[int]]) -> list[tuple[str, int]]:
    """Reasons and numbers of what is shown, each number for its first reason alone."""
    shown: dict[int, str] = {}
    for why, numbers in named.items():
        for number in numbers:
            shown.setdefault(int(number), why)
    return [(why, number) for number, why in shown.items()]


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """One picture of a pair."""

    name: str  # `truth`, `input`, or a method's
    image: Image  # (PANEL_PX, PANEL_PX, 3)
    # position_m, heading_rad: the error in the picture; None for the truth.
    position_m: float | None = None
    heading_rad: float | None = None
    failed: bool = False  # the method found no estimate, and the input is shown

    @property
    def good(self) -> bool | None:
        """Whether the error is a success; None for the truth, the input and attention."""
        if self.position_m is None or self.heading_rad is None or self.name == "input":
            return None
        return not self.failed and self.position_m <= SUCCESS_M and self.heading_rad <= SUCCESS_RAD


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """A pair in the gallery: why it is shown, its overlap and its pictures."""

    pair_id: str
    why: str
    overlap: float
    panels: tuple[Panel, ...]


def panels(pair: MapPair, sample: PerturbedPair, outcomes: pd.DataFrame) -> list[Panel]:
    """Truth, input and each method's correction of one pair, all in the axes of m0 and at one scale.

    Args:
        pair: the maps and their true transform.
        sample: the pair as the methods saw it.
        outcomes: the rows of this pair in an `outcome_table`, one for each method that is shown.
    """
    square, theta = square_around(pair), sample.theta_v

    def panel(name: str, T_m0_m1: SE2, **error: Any) -> Panel:
        return Panel(name=name, image=overlay(pair, T_m0_m1, *square), **error)

    input_m, input_rad = float(np.hypot(theta.x_m, theta.y_m)), abs(theta.yaw_rad)
    drawn = [
        panel("truth", pair.T_m0_m1),
        panel("input", sample.T_estimated, position_m=input_m, heading_rad=input_rad),
    ]
    for row in outcomes.itertuples():
        T_hat = corrected(sample.T_estimated, row.theta_hat or SE2.identity(), sample.T_m0_v)
        error = {"position_m": row.position_m, "heading_rad": row.heading_rad, "failed": row.failed}
        drawn.append(panel(row.method, T_hat, **error))
    return drawn


def square_around(pair: MapPair) -> tuple[SE2, float]:
    """Centre, in m0, and side [m] of a square around both maps as they truly lie."""
    placed = ((pair.grid_0, SE2.identity()), (pair.grid_1, pair.T_m0_m1))
    lower_m, upper_m = bounds_m(placed, _MARGIN_M)
    x_m, y_m = (lower_m + upper_m) / 2.0
    return SE2(float(x_m), float(y_m), 0.0), float((upper_m - lower_m).max())


def overlay(pair: MapPair, T_m0_m1: SE2, T_m0_v: SE2, side_m: float) -> Image:
    """(PANEL_PX, PANEL_PX, 3): both maps and robot 1 in a square of that side around v."""
    window = map_window(pair.grid_0, pair.grid_1, T_m0_m1, T_m0_v, cells=PANEL_PX, cell_m=side_m / PANEL_PX)
    canvas = Canvas(PANEL_PX, PANEL_PX)
    canvas.image[:] = _painted(window)
    px_per_m = PANEL_PX / side_m
    view = View(px_per_m=px_per_m, u0_px=PANEL_PX / 2.0, v0_px=PANEL_PX / 2.0)
    T_v_m0 = T_m0_v.inverse()
    draw_robot(canvas, view, T_v_m0 @ pair.T_m0_r1, INK)
    draw_robot(canvas, view, T_v_m0 @ T_m0_m1 @ pair.T_m1_r1, BLUE)
    canvas.scale_bar(12, PANEL_PX - 14, px_per_m=px_per_m, longest_px=90)
    return canvas.image


def _painted(window: MapWindow) -> Image:
    """(N, N, 3): red map 0, blue map 1, violet both; y up."""
    cells = window.cells[:, ::-1]
    return in_colours(cells != UNKNOWN_CELL, cells == OCCUPIED_CELL)


def attention_panel(window: MapWindow, attention: Array) -> Image:
    """A window with the places that get more than an even share of a network's attention.

    Args:
        window: both maps as it saw them.
        attention: (P, P) share of each place, row growing with +y; they sum to 1.
    """
    image = cv2.resize(_painted(window), (PANEL_PX, PANEL_PX), interpolation=cv2.INTER_AREA)
    times_even = (attention * attention.size)[::-1]
    heat = cv2.resize(times_even, (PANEL_PX, PANEL_PX), interpolation=cv2.INTER_CUBIC)
    opacity = 0.75 * ((heat - 1.0) / (_FULL_HEAT - 1.0)).clip(0.0, 1.0)[..., None]
    return np.asarray((1.0 - opacity) * image + opacity * np.array(_HEAT), dtype=np.uint8)
