"""The part of the report on the whole system: Fig. 7 of the paper."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd
from markupsafe import Markup

from rendezvous.alignment.estimate import WRONG_M, WRONG_RAD
from rendezvous.evaluation.frame_error.estimates import OVERLAP_BINS, SUCCESS_M, SUCCESS_RAD
from rendezvous.evaluation.fusion.gallery import FusionShown
from rendezvous.evaluation.fusion.paper_scenario import PAPER_OVERLAP
from rendezvous.evaluation.fusion.runs import (
    ESTIMATED,
    METHODS,
    NONE,
    SOURCES,
    TRUE,
    FusionOutcome,
    FusionRun,
    run_name,
)
from rendezvous.evaluation.fusion.summary import FusionFigures
from rendezvous.evaluation.report.page import ReportPart, render_part
from rendezvous.evaluation.report.recorded_figures import ImageConditions, RecordedFigures
from rendezvous.evaluation.report.violins import Component, violin_chart
from rendezvous.geometry.se2 import SE2
from rendezvous.methods import REFINEMENTS

KEY = "fusion"
TITLES = {name: way.title for name, way in REFINEMENTS.items()}
_COMPONENTS = (
    Component(column="position_m", name="position", unit="m", axis=(0.0, 0.5)),
    Component(column="heading_deg", name="heading", unit="°", axis=(0.0, 5.0)),
    Component(column="iou", name="map agreement", unit="", axis=(0.0, 1.01), label="intersection over union"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionContent:
    """Everything the part shows."""

    conditions: ImageConditions  # of this run's measurements
    found: pd.DataFrame  # a table of `fusion_table`, measured in this run
    best: FusionRun  # the run that is shown in detail
    # Figures by the run's name, measured in this run or recorded, in the order of tables.
    rows: Mapping[str, RecordedFigures[FusionFigures]]
    gallery: Sequence[FusionShown]  # rendezvous that are drawn
    scenario: FusionShown | None  # the paper's; None if no pair fits it
    dataset: str  # its folder
    versions: Mapping[str, str]  # of packages

    @property
    def measured(self) -> set[str]:
        """Names of the runs that were measured in this run."""
        return set((self.found.source + "-" + self.found.method).unique())

    def rows_of(self, source: str) -> list[tuple[str, str, RecordedFigures[FusionFigures]]]:
        """Name, method and figures of the runs with relative poses of a source."""
        named = [(run_name((source, method)), method) for method in METHODS]
        return [(name, method, self.rows[name]) for name, method in named if name in self.rows]


def fusion_part(content: FusionContent) -> ReportPart:
    """The part; sections with nothing to show are left out."""
    c = content.conditions
    known = [
        (f"of them {name} knows", "not known" if count is None else f"{count:,}")
        for name, count in c.trained_on.items()
    ]
    return render_part(
        KEY,
        title="Fusion: one image and two maps into one map",
        facts=c.facts(("rendezvous", f"{c.images:,}"), ("floor plans", f"{c.plans:,}"), *known),
        c=content,
        figures=content.rows[run_name(content.best)].figures,
        best_title=TITLES[content.best[1]].removeprefix("+ "),
        titles=TITLES,
        sources={ESTIMATED: "Estimated relative pose", TRUE: "True relative pose"},
        overlap_bins=OVERLAP_BINS,
        paper_overlap=PAPER_OVERLAP,
        charts=_charts(content),
        distance_m=distance_m,
        is_good=is_good,
        limits=f"{SUCCESS_M:g} m and {math.degrees(SUCCESS_RAD):.0f}°",
        wrong=f"{WRONG_M:g} m or {math.degrees(WRONG_RAD):.0f}°",
        made_from=c.origin(content.dataset, content.versions),
    )


def distance_m(error: SE2) -> float:
    """Distance of an error's x and y."""
    return math.hypot(error.x_m, error.y_m)


def is_good(outcome: FusionOutcome) -> bool:
    """Whether a fused map is a success."""
    error = outcome.error
    return error is not None and distance_m(error) <= SUCCESS_M and abs(error.yaw_rad) <= SUCCESS_RAD


def _charts(content: FusionContent) -> dict[str, Markup]:
    """Errors by method for each source of the relative pose, and those of the best run by overlap."""
    table = content.found.assign(
        heading_deg=content.found.heading_rad * 180.0 / math.pi,
        titles=pd.Categorical(content.found.method.map(TITLES), TITLES.values()),
    )
    charts = {}
    for source in SOURCES:
        # The true relative pose alone has no error.
        rows = table[(table.source == source) & ((table.source != TRUE) | (table.method != NONE))]
        if len(rows):
            charts[source] = violin_chart(rows, "titles", _COMPONENTS)
    of_best = table[(table.source == content.best[0]) & (table.method == content.best[1])]
    return {**charts, "overlap": violin_chart(of_best, "overlaps", _COMPONENTS)}
