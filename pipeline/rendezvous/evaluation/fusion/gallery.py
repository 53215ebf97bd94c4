"""Rendezvous as the system fuses them: red map 0, blue map 1 where the transform puts it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from rendezvous.evaluation.frame_error.estimates import SUCCESS_M, SUCCESS_RAD
from rendezvous.evaluation.frame_error.gallery import overlay, square_around
from rendezvous.evaluation.fusion.runs import ESTIMATED, NONE, FusionOutcome, RendezvousOutcome, Run
from rendezvous.evaluation.pictures.canvas import Image, encoded_png
from rendezvous.evaluation.report.html_page import Html, Piece, joined, paragraph, picture, strong
from rendezvous.training.frame_error.pairs import MapPair

TITLES = {
    NONE: "Relative pose only",
    "hough": "+ Hough",
    "orb": "+ ORB",
    "correlative": "+ correlative search",
    "learned": "+ learned matcher",
    "auto": "+ learned, told the pose's covariance",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionShown:
    """One rendezvous of the gallery.

    Attributes:
        why: it is shown.
        pair_id, overlap: of its maps.
        outcome: of all its runs.
        truth: the true fusion.
        panels: the runs that are drawn, each with its picture.
    """

    why: str
    pair_id: str
    overlap: float
    outcome: RendezvousOutcome
    truth: Image
    panels: tuple[tuple[Run, Image], ...]


def fusion_shown(why: str, pair: MapPair, outcome: RendezvousOutcome, runs: Sequence[Run]) -> FusionShown:
    """The true fusion, that by the estimated pose alone, and that by some of its runs, all at one scale.

    Runs without a fused map are left out.
    """
    view = square_around(pair)
    drawn = dict.fromkeys([(ESTIMATED, NONE), *runs])
    return FusionShown(
        why=why,
        pair_id=pair.pair_id,
        overlap=pair.overlap,
        outcome=outcome,
        truth=overlay(pair, pair.T_m0_m1, *view),
        panels=tuple(
            (run, overlay(pair, found.T_m0_m1, *view))
            for run in drawn
            if (found := outcome.runs.get(run)) is not None and found.T_m0_m1 is not None
        ),
    )


def rendezvous_html(shown: FusionShown) -> Html:
    """Its pictures and errors."""
    pieces = [_figure(strong("True fusion"), shown.truth)]
    pieces += [
        _figure(_caption(TITLES[run[1]], shown.outcome.runs[run]), image) for run, image in shown.panels
    ]
    return joined(
        paragraph(f"{shown.pair_id}, overlap {shown.overlap:.3f}", kind="note"),
        Html(f'<div class="images">{"".join(piece.text for piece in pieces)}</div>'),
    )


def error_words(outcome: FusionOutcome) -> str:
    """The error of T̂."""
    if outcome.error is None:
        return "no fused map"
    distance_m = math.hypot(outcome.error.x_m, outcome.error.y_m)
    return f"{distance_m:.3f} m, {math.degrees(abs(outcome.error.yaw_rad)):.1f}°"


def is_good(outcome: FusionOutcome) -> bool:
    """Whether it is a success."""
    if outcome.error is None:
        return False
    distance_m = math.hypot(outcome.error.x_m, outcome.error.y_m)
    return distance_m <= SUCCESS_M and abs(outcome.error.yaw_rad) <= SUCCESS_RAD


def _caption(name: str, outcome: FusionOutcome) -> Html:
    verdict = "accepted" if outcome.accepted else f"uncertain: {'; '.join(outcome.reasons)}"
    kind = "good" if is_good(outcome) else "bad"
    iou = "" if outcome.iou is None else f", map agreement {outcome.iou:.2f}"
    return joined(
        strong(name),
        Html(f'<br><span class="{kind}">'),
        error_words(outcome),
        Html("</span>"),
        iou,
        Html("<br>"),
        verdict,
    )


def _figure(caption: Piece, image: Image) -> Html:
    drawn = picture(encoded_png(image), alt="both maps")
    return Html(f"<figure>{drawn.text}<figcaption>{joined(caption).text}</figcaption></figure>")
