"""The part of the report on frame-error estimators."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pandas as pd

from rendezvous.alignment.estimate import WRONG_M, WRONG_RAD
from rendezvous.evaluation import statistics
from rendezvous.evaluation.frame_error import symmetry
from rendezvous.evaluation.frame_error.charts import calibration_chart, cdf_chart, curve_chart, scatter_chart
from rendezvous.evaluation.frame_error.estimates import SUCCESS_M, SUCCESS_RAD
from rendezvous.evaluation.frame_error.gallery import Panel, Shown
from rendezvous.evaluation.frame_error.measured_row import MeasuredRow, PairConditions
from rendezvous.evaluation.frame_error.summary import Comparison, ranking
from rendezvous.evaluation.frame_error.symmetry import Symmetry
from rendezvous.evaluation.frame_error.training_curve import STILL_FALLING
from rendezvous.evaluation.report.page import ReportPart, render_part
from rendezvous.methods import Method

if TYPE_CHECKING:
    from markupsafe import Markup

KEY = "frame_error"


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameErrorContent:
    """Everything the part shows."""

    conditions: PairConditions  # of this run's measurements
    # The shipped methods and those that the user added, by name, in the order of tables.
    methods: Mapping[str, Method]
    outcomes: pd.DataFrame  # the `outcome_table` of this run
    # Figures by method, measured in this run or recorded, in the order of tables.
    rows: Mapping[str, MeasuredRow]
    # Errors on symmetric scenes; None where frame errors are too small for them to matter.
    symmetry: Symmetry | None
    comparisons: Sequence[Comparison]  # the best method of this run against each other one
    gallery: Sequence[Shown]  # pairs that are drawn
    # By method, pictures of what it attends to, one for each pair of the gallery.
    attention: Mapping[str, Sequence[Panel]]
    dataset: str  # its folder
    versions: Mapping[str, str]  # of packages

    @property
    def measured(self) -> list[str]:
        """Methods of this run, in the order of tables."""
        return list(self.outcomes["method"].unique())

    @property
    def table_one(self) -> list[str]:
        """Names of the paper's rows, whether or not there are figures for them."""
        return [name for name, method in self.methods.items() if method.row is not None]

    @property
    def ranked(self) -> list[str]:
        """Methods of this run, the smallest mean position error first."""
        return ranking(self.outcomes)

    @property
    def best(self) -> list[str]:
        """The methods of this run with the smallest mean |x|, |y| and |yaw|, and the most successes."""
        rows = self.outcomes.set_index("method")
        means = rows[["x_m", "y_m", "yaw_rad"]].abs().groupby(level=0, sort=False).mean().idxmin()
        return [*means, rows.groupby(level=0, sort=False)["success"].mean().idxmax()]

    @property
    def best_by_overlap(self) -> dict[str, str]:
        """By bin, the method of this run with the smallest mean position error in it."""
        means = self.outcomes.pivot_table(
            "position_m", "overlaps", "method", aggfunc="mean", observed=True, sort=False
        )
        return dict(means.idxmin(axis="columns"))

    @property
    def overlap_bins(self) -> list[tuple[str, int]]:
        """Headings of the bins of overlap, each over three columns."""
        sizes = self.rows[self.measured[0]].summary.by_overlap
        return [
            (f"overlap {label}, {f'{found.count} pairs' if found else 'none'}", 3)
            for label, found in sizes.items()
        ]

    @property
    def origin(self) -> list[tuple[str, str]]:
        """Names and values of everything the part was made from."""
        c = self.conditions
        digests = {
            "digest of the pairs": c.data_digest,
            "digest of the frame errors": c.perturbation_digest,
            "seed of the frame errors": str(c.seed),
        }
        for name, row in self.rows.items():
            if row.training is not None:
                digests[f"weights of {self.title(name)}"] = row.training.weights_digest
        return c.made_from(digests, self.dataset, self.versions)

    def title(self, name: str) -> str:
        """A method's title."""
        return self.methods[name].title

    def remarks(self, name: str) -> list[str]:
        """Remarks on a row: its pairs, if they are not those of this run, and its method's training."""
        row, remarks = self.rows[name], []
        c = row.conditions
        if name not in self.measured:
            here = self.conditions
            other = "" if c.same_pairs(here) else f", not the {here.pairs:,} of {here.split} measured here"
            commit = f", commit {c.commit[:9]}" if c.commit else ""
            remarks.append(f"{c.pairs:,} pairs of {c.split}{other}, data {c.data_digest[:9]}{commit}")
        if row.training is not None:
            minutes = "" if row.training.minutes is None else f", {row.training.minutes:.1f} min"
            remarks.append(f"seed {row.training.seed}, {row.training.samples:,} samples{minutes}")
            if row.plans_trained_on is None:
                remarks.append("whether it was trained on these plans is not known")
        return remarks


def frame_error_part(content: FrameErrorContent) -> ReportPart:
    """The part; sections with nothing to show are left out."""
    c = content.conditions
    return render_part(
        KEY,
        title="Frame error: how well two robots' maps are brought together",
        facts=c.facts(
            ("pairs", f"{c.pairs:,}"),
            ("floor plans", f"{c.plans:,}"),
            ("frame error drawn from", f"±{c.xy_range_m:g} m, ±{c.yaw_range_deg:g}°"),
        ),
        c=content,
        charts=_charts(content),
        statistics=statistics,
        symmetry=symmetry,
        still_falling=STILL_FALLING,
        success_m=SUCCESS_M,
        limits=f"{SUCCESS_M:g} m and {math.degrees(SUCCESS_RAD):.0f}°",
        wrong=f"{WRONG_M:g} m or {math.degrees(WRONG_RAD):.0f}°",
    )


def _charts(content: FrameErrorContent) -> dict[str, Markup | None]:
    """By the name that the template has for each; None where there is nothing to draw."""
    curves = {
        name: row.training.curve
        for name, row in content.rows.items()
        if row.training is not None and row.training.curve is not None
    }
    outcomes, methods = content.outcomes, content.methods
    return {
        "scatter": scatter_chart(outcomes, methods),
        "cdf": cdf_chart(outcomes, methods),
        "calibration": calibration_chart(outcomes, methods),
        "curves": curve_chart(curves, methods),
    }
