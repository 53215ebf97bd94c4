"""The part of the report on the relative pose: Fig. 5 of the paper."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd
from markupsafe import Markup

from rendezvous.alignment.window import PAPER_XY_M, PAPER_YAW_RAD
from rendezvous.evaluation.frame_error.calibration import LEVELS
from rendezvous.evaluation.relative_pose import summary
from rendezvous.evaluation.relative_pose.gallery import PoseShown
from rendezvous.evaluation.relative_pose.summary import GROUPS, PoseSummary, grouped
from rendezvous.evaluation.report.page import ReportPart, render_part
from rendezvous.evaluation.report.recorded_figures import ImageConditions, RecordedFigures
from rendezvous.evaluation.report.violins import Component, violin_chart
from rendezvous.evaluation.statistics import Interval

KEY = "relative_pose"
VARIANTS = {"floor": "Floor known", "free": "6 degrees of freedom"}
"""Titles of what an estimator may take as known, in the order of tables."""

_COMPONENTS = (
    Component(column="dx_m", name="Δx", unit="m"),
    Component(column="dy_m", name="Δy", unit="m"),
    Component(column="dyaw_deg", name="Δψ", unit="°"),
)
_EXTREMES = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class FloorGain:
    """Differences of mean errors, floor minus free, on images in which both variants found the robot."""

    images: int
    # position_m, heading_rad: negative where the floor helps.
    position_m: Interval
    heading_rad: Interval


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseContent:
    """Everything the part shows."""

    conditions: ImageConditions  # of this run's measurements
    # Tables of `pose_table` by variant, measured in this run; the first is shown in detail.
    found: Mapping[str, pd.DataFrame]
    # Figures by variant, measured in this run or recorded, in the order of tables.
    rows: Mapping[str, RecordedFigures[PoseSummary]]
    gain: FloorGain | None  # what the floor changes; None unless this run measured both variants
    gallery: Sequence[PoseShown]  # images that are drawn
    dataset: str  # its folder
    versions: Mapping[str, str]  # of packages

    @property
    def main(self) -> str:
        """The variant that is shown in detail."""
        return next(iter(self.found))

    @property
    def extremes(self) -> list[tuple[str, list[Any]]]:
        """The detections with the largest errors in position, then in heading."""
        images = self.found[self.main]
        return [
            (name, list(images[images.detected].nlargest(_EXTREMES, column).itertuples()))
            for name, column in (("position", "position_m"), ("heading", "turn_rad"))
        ]


def pose_part(content: PoseContent) -> ReportPart:
    """The part; sections with nothing to show are left out."""
    return render_part(
        KEY,
        title="Relative pose: where one image puts the other robot",
        facts=_facts(content.conditions, content.found[content.main]),
        c=content,
        figures=content.rows[content.main].figures,
        titles=VARIANTS,
        levels=LEVELS,
        goal=summary,
        window_xy_m=PAPER_XY_M,
        window_yaw_rad=PAPER_YAW_RAD,
        charts=_charts(content),
        made_from=content.conditions.origin(content.dataset, content.versions),
    )


def _facts(c: ImageConditions, images: pd.DataFrame) -> list[tuple[str, str]]:
    known = c.trained_on.get("relative pose")
    return c.facts(
        *((f"{kind} images", f"{count:,}") for kind, count in images.kind.value_counts(sort=False).items()),
        ("without the robot", f"{int((~images.shows_robot).sum()):,}"),
        ("floor plans", f"{c.plans:,}"),
        ("of them trained on", "not known" if known is None else f"{known:,}"),
    )


def _charts(content: PoseContent) -> dict[str, Markup | None]:
    """Violins by variant and by the groups of the main variant; None where no image shows the robot."""
    shown = {name: images[images.shows_robot] for name, images in content.found.items()}
    if not len(shown[content.main]):
        return dict.fromkeys(("variant", *GROUPS))
    titled = [images.assign(variant=VARIANTS[name]) for name, images in shown.items()]
    titles = [VARIANTS[name] for name in shown]
    every = pd.concat(titled).assign(variant=lambda all_: pd.Categorical(all_.variant, titles))
    by = {"variant": (every, "variant")} | {
        name: (grouped(shown[content.main]), column) for name, column in GROUPS.items() if name != "kind"
    }
    return {
        name: violin_chart(images.assign(dyaw_deg=images.dyaw_rad * 180.0 / math.pi), column, _COMPONENTS)
        for name, (images, column) in by.items()
    }
