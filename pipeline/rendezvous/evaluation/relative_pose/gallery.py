"""Images with the cuboid that an estimator read from them: the best, the median, the worst, missed, false."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pandas as pd

from rendezvous.evaluation.frame_error.gallery import shown_once
from rendezvous.evaluation.pictures.poses import labelled_image
from rendezvous.evaluation.relative_pose.errors import PoseOutcome
from rendezvous.evaluation.relative_pose.summary import TARGET_HEADING_RAD, TARGET_POSITION_M
from rendezvous.geometry.camera import Image, PinholeCamera
from rendezvous.geometry.cuboid import Vec3, project_cuboid
from rendezvous.geometry.se2 import Array

IMAGE_PX = 420
_EACH = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseShown:
    """One image of the gallery.

    Attributes:
        why: why it is shown, e.g. best.
        row: of the image in a table of `pose_table`.
        image: with the cuboid that was read, and the box of the robot's visible pixels.
    """

    why: str
    row: Any
    image: Image


def chosen_images(images: pd.DataFrame, *, each: int = _EACH) -> list[tuple[str, int]]:
    """Reasons and row numbers of the best, median and worst detections, of missed robots and false ones.

    Best and median are by the sum of both errors, each divided by its goal. Half of the worst have the
    largest errors in position, half in heading. The missed are those of which most is visible, the false
    detections those of the highest score.
    """
    made = images[images.detected]
    by_both = (made.position_m / TARGET_POSITION_M + made.turn_rad / TARGET_HEADING_RAD).sort_values(
        kind="stable"
    )
    middle = max(len(made) // 2 - each // 2, 0)
    worst = [*made.position_m.nlargest(each // 2).index, *made.turn_rad.nlargest(each).index]
    missed = images[images.shows_robot & ~images.found]
    false = images[~images.shows_robot & images.found]
    return shown_once(
        {
            "best": by_both.index[:each],
            "median": by_both.index[middle : middle + each],
            "worst": list(dict.fromkeys(worst))[:each],
            "missed": missed.visibility.nlargest(each).index,
            "false detection": false.score.nlargest(each).index,
        }
    )


def pose_shown(
    why: str,
    row: Any,
    outcome: PoseOutcome,
    *,
    encoded: bytes,
    camera: PinholeCamera,
    cuboid_size_m: Vec3,
    box_px: Array | None,
) -> PoseShown:
    """An image of the gallery: its row of the table, its outcome and what is needed to draw it."""
    read = None if outcome.T_c_o is None else project_cuboid(outcome.T_c_o, cuboid_size_m, camera)
    drawn = {"image": encoded, "projected_cuboid_px": read, "box_px": box_px, "pose_id": outcome.image_id}
    return PoseShown(why=why, row=row, image=labelled_image(drawn, width_px=IMAGE_PX))
