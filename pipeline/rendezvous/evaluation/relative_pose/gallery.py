"""Images with the cuboid that an estimator read from them: the best, the median, the worst, missed, false."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rendezvous.evaluation.pictures.canvas import Image, encoded_png
from rendezvous.evaluation.pictures.poses import labelled_image
from rendezvous.evaluation.relative_pose.errors import ImageTruth, PoseOutcome, PoseOutcomes
from rendezvous.evaluation.relative_pose.summary import TARGET_HEADING_RAD, TARGET_POSITION_M
from rendezvous.evaluation.report.html_page import Html, joined, paragraph, picture, strong, subheading
from rendezvous.geometry.camera import PinholeCamera
from rendezvous.geometry.cuboid import Vec3, project_cuboid
from rendezvous.geometry.se2 import Array

IMAGE_PX = 420
_EACH = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseShown:
    """One image of the gallery.

    Attributes:
        why: it is shown, e.g. best.
        truth: what it shows.
        outcome: what was read from it.
        position_m, heading_rad: the error; NaN where there is none.
        image: with the cuboid that was read, and the box of the robot's visible pixels.
    """

    why: str
    truth: ImageTruth
    outcome: PoseOutcome
    position_m: float
    heading_rad: float
    image: Image


def chosen_images(found: PoseOutcomes, *, each: int = _EACH) -> list[tuple[str, int]]:
    """Which images are shown, and why: the best, median and worst detections, missed and false ones.

    Best and median are by both components, each measured by what is wanted of it. The worst are half those
    with the largest errors in position and half in heading. Of the missed, those of
    which most is visible; of the false, those of the highest score.
    """
    made = np.flatnonzero(found.detected)
    off = found.position_m / TARGET_POSITION_M + found.heading_rad / TARGET_HEADING_RAD
    by_both = made[np.argsort(off[made], kind="stable")]
    by_position = made[np.argsort(found.position_m[made], kind="stable")]
    by_heading = made[np.argsort(found.heading_rad[made], kind="stable")]
    missed = np.flatnonzero(found.shows_robot & ~found.found)
    missed = missed[np.argsort(-found.truth("visibility")[missed], kind="stable")]
    false = np.flatnonzero(~found.shows_robot & found.found)
    scores = np.array([found.rows[number].score for number in false])
    middle = max(len(made) // 2 - each // 2, 0)
    worst = [*dict.fromkeys([*by_position[::-1][: each // 2].tolist(), *by_heading[::-1][:each].tolist()])]
    named = {
        "best": by_both[:each],
        "median": by_both[middle : middle + each],
        "worst": np.array(worst[:each], dtype=np.int64),
        "missed": missed[:each],
        "false detection": false[np.argsort(-scores, kind="stable")][:each],
    }
    shown: dict[int, str] = {}
    for why, numbers in named.items():
        for number in numbers:
            shown.setdefault(int(number), why)
    return [(why, number) for number, why in shown.items()]


def pose_shown(
    why: str,
    found: PoseOutcomes,
    number: int,
    *,
    encoded: bytes,
    camera: PinholeCamera,
    cuboid_size_m: Vec3,
    box_px: Array | None,
) -> PoseShown:
    """One image of the gallery, drawn."""
    outcome = found.rows[number]
    read = None if outcome.T_c_o is None else project_cuboid(outcome.T_c_o, cuboid_size_m, camera)
    row = {"image": encoded, "projected_cuboid_px": read, "box_px": box_px, "pose_id": outcome.image_id}
    return PoseShown(
        why=why,
        truth=found.truths[number],
        outcome=outcome,
        position_m=float(found.position_m[number]),
        heading_rad=float(found.heading_rad[number]),
        image=labelled_image(row, width_px=IMAGE_PX),
    )


def pose_gallery(shown: Sequence[PoseShown]) -> list[Html]:
    """The gallery's section; empty without images."""
    if not shown:
        return []
    out = [
        paragraph(
            "The cuboid that was read from each image (orange: its front), and in white the box of the "
            "robot's visible pixels, from the truth. A small robot is magnified in a corner."
        )
    ]
    for why in dict.fromkeys(each.why for each in shown):
        pictures = "".join(_figure(each).text for each in shown if each.why == why)
        out.append(joined(subheading(_PLURALS[why]), Html(f'<div class="images">{pictures}</div>')))
    return out


_PLURALS = {
    "best": "Best",
    "median": "Median",
    "worst": "Worst in position and in heading",
    "missed": "Missed, those first of which most is visible",
    "false detection": "False detections",
}


def _figure(shown: PoseShown) -> Html:
    words: list[str] = []
    if math.isfinite(shown.position_m):
        words.append(f"off by {shown.position_m:.3f} m, {math.degrees(shown.heading_rad):.1f}°")
    elif shown.outcome.reason:
        words.append(shown.outcome.reason)
    if shown.truth.shows_robot:
        words.append(f"at {shown.truth.distance_m:.2f} m, {shown.truth.visibility:.0%} visible")
    words.append(f"score {shown.outcome.score:.2f}")
    image = picture(encoded_png(shown.image), alt=shown.why)
    caption = joined(strong(shown.truth.kind), Html("<br>"), "; ".join(words))
    return Html(f"<figure>{image.text}<figcaption>{caption.text}</figcaption></figure>")
