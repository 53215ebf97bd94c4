"""Images with the cuboid that an estimator read from them: the best, the median, the worst, missed, false."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pandas as pd

from rendezvous.evaluation.frame_error.gallery import shown_once
from rendezvous.evaluation.relative_pose.summary import TARGET_HEADING_RAD, TARGET_POSITION_M
from rendezvous.geometry.camera import Image

IMAGE_PX = 420
_EACH = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseShown:
    """One image of the gallery."""

    why: str  # why it is shown, e.g. best
    row: Any  # of the image in a table of `pose_table`
    image: Image  # with the cuboid that was read, and the box of the robot's visible pixels


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
