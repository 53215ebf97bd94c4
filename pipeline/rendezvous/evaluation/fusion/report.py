"""The part of the report on the whole system: Fig. 7 of the paper."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rendezvous.alignment.estimate import WRONG_M, WRONG_RAD
from rendezvous.evaluation.frame_error.estimates import SUCCESS_M, SUCCESS_RAD
from rendezvous.evaluation.frame_error.summary import OVERLAP_BINS, OVERLAP_EDGES
from rendezvous.evaluation.fusion.gallery import TITLES, FusionShown, rendezvous_html
from rendezvous.evaluation.fusion.paper_scenario import PAPER_OVERLAP
from rendezvous.evaluation.fusion.runs import AUTO, ESTIMATED, METHODS, NONE, TRUE, Run
from rendezvous.evaluation.fusion.summary import FusionFigures, FusionOutcomes
from rendezvous.evaluation.fusion.tables import (
    fusion_table,
    overlap_table,
    scenario_table,
    verdict_table,
)
from rendezvous.evaluation.relative_pose.tables import share_words
from rendezvous.evaluation.relative_pose.violins import Component, violin_chart
from rendezvous.evaluation.report.html_page import (
    Html,
    figure,
    joined,
    old_part,
    paragraph,
    strong,
    subheading,
)
from rendezvous.evaluation.report.origin import origin_table
from rendezvous.evaluation.report.page import ReportPart
from rendezvous.evaluation.report.recorded_figures import ImageConditions, RecordedFigures
from rendezvous.geometry.se2 import Array

KEY = "fusion"
_POSITION = Component(name="position", unit="m", axis=(0.0, 0.5))
_HEADING = Component(name="heading", unit="°", axis=(0.0, 5.0))
_IOU = Component(name="map agreement", unit="", axis=(0.0, 1.01), label="intersection over union")

Rows = Mapping[str, RecordedFigures[FusionFigures]]


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionContent:
    """All that the part tells.

    Attributes:
        conditions: of what was measured now.
        found: outcomes by run, measured now.
        overlap: (N,) of the rendezvous.
        rows: figures by the run's name, measured now or recorded, in the order of tables.
        gallery: rendezvous that are drawn.
        scenario: the paper's; None if no pair fits it.
        dataset: its folder.
        versions: of packages.
    """

    conditions: ImageConditions
    found: Mapping[Run, FusionOutcomes]
    overlap: Array
    rows: Rows
    gallery: Sequence[FusionShown]
    scenario: FusionShown | None
    dataset: str
    versions: Mapping[str, str]


def run_name(run: Run) -> str:
    """What files and figures call a run."""
    return "-".join(run)


def best_run(found: Mapping[Run, FusionOutcomes]) -> Run:
    """The system as it ships if that was measured, or else the run of most successes with estimated poses."""
    if (ESTIMATED, AUTO) in found:
        return ESTIMATED, AUTO
    estimated = [run for run in found if run[0] == ESTIMATED]
    return max(estimated, key=lambda run: int(found[run].success.sum()))


def chosen_rendezvous(found: Mapping[Run, FusionOutcomes]) -> list[tuple[str, int, Run]]:
    """The best, median and worst fused maps of the best run: why, number, run.

    By both components of the error, each measured by what counts as a success.
    """
    run = best_run(found)
    made = np.flatnonzero(found[run].made)
    off = found[run].position_m / SUCCESS_M + found[run].heading_rad / SUCCESS_RAD
    order = made[np.argsort(off[made], kind="stable")]
    if not len(order):
        return []
    named = {"best": order[0], "median": order[len(order) // 2], "worst": order[-1]}
    shown: dict[int, str] = {}
    for why, number in named.items():
        shown.setdefault(int(number), why)
    return [(why, number, run) for number, why in shown.items()]


def fusion_part(content: FusionContent) -> ReportPart:
    """The part; sections that have nothing to tell are left out."""
    measured = [run_name(run) for run in content.found]
    sections = [
        ("methods", "By method, with the estimated and the true relative pose", _methods(content, measured)),
        ("errors", "How errors are spread", _spread(content)),
        ("overlap", "By overlap", _overlap(content, measured)),
        ("verdict", "Does it know when it is wrong?", _verdict(content, measured)),
        ("gallery", "Fused maps (the paper's Fig. 7)", _gallery(content)),
        ("scenario", "The paper's scenario", _scenario(content)),
        ("origin", "How it was made", [_origin(content)]),
    ]
    return old_part(
        key=KEY,
        title="Fusion: one image and two maps into one map",
        lead=_lead(content),
        shown_facts=_facts(content),
        sections=tuple((anchor, heading, joined(*pieces)) for anchor, heading, pieces in sections if pieces),
    )


def _lead(content: FusionContent) -> Html:
    run = best_run(content.found)
    figures = content.rows[run_name(run)].figures
    group = figures.overall
    error = ""
    if group.position_m is not None and group.heading_rad is not None:
        degrees = math.degrees(group.heading_rad.median)
        error = f", median error {group.position_m.median:.3f} m and {degrees:.2f}°"
    return paragraph(
        strong(f"{share_words(group.success)} of {group.success.of:,} rendezvous"),
        f" are fused within {SUCCESS_M:g} m and {math.degrees(SUCCESS_RAD):.0f}° by one image and both maps "
        f"({TITLES[run[1]].removeprefix('+ ')}){error}; the robot was found in {share_words(group.made)}. "
        f"The verdict accepts {share_words(figures.accepted)}; of these "
        f"{share_words(figures.wrong_accepted)} are wrong by more than {WRONG_M:g} m or "
        f"{math.degrees(WRONG_RAD):.0f}°.",
        kind="lead",
    )


def _facts(content: FusionContent) -> tuple[tuple[str, str], ...]:
    c = content.conditions
    return (
        ("split", c.split),
        ("rendezvous", f"{c.images:,}"),
        ("floor plans", f"{c.plans:,}"),
        *(
            (f"of them {name} knows", "not known" if known is None else f"{known:,}")
            for name, known in c.trained_on.items()
        ),
        ("data", c.data_digest[:12]),
        ("seed", str(c.seed)),
    )


def _methods(content: FusionContent, measured: Sequence[str]) -> list[Html]:
    return [
        paragraph(
            "Each rendezvous is fused from both maps, both SLAM poses and the relative pose: as it is read "
            "from the image, or the true one. T̃ (Eq. 2) is then refined in several ways. The error is what T̂ "
            "has left at the meeting point, against the transform that makes the maps agree there; so the "
            "true relative pose alone has none, and a refinement of it shows the refinement's own error."
        ),
        fusion_table(content.rows, measured),
        paragraph(
            f"Success: within {SUCCESS_M:g} m and {math.degrees(SUCCESS_RAD):.0f}°; a rendezvous in which "
            "the robot is not found has no fused map and is no success. Errors and agreement are of the "
            "fused. Agreement: occupied cells of the fused and of the truly fused map that have a partner in "
            "the other within a cell, as intersection over union; map 0, which is in both, makes it never "
            "zero. Where the maps tell nothing, T̂ stays T̃.",
            kind="note",
        ),
    ]


def _spread(content: FusionContent) -> list[Html]:
    pieces = []
    for source, words in ((ESTIMATED, "estimated"), (TRUE, "true")):
        groups = {
            TITLES[method]: _errors(content.found[(source, method)])
            for method in METHODS
            if (source, method) in content.found and (source, method) != (TRUE, NONE)
        }
        if groups:
            chart = violin_chart(groups, (_POSITION, _HEADING, _IOU))
            caption = f"With the {words} relative pose. “Of” counts rendezvous without a fused map."
            pieces.append(figure(chart, caption, alt=f"Errors with the {words} relative pose"))
    return pieces


def _errors(found: FusionOutcomes) -> Array:
    """(N, 3) position [m], heading [°], agreement."""
    return np.stack([found.position_m, np.degrees(found.heading_rad), found.iou], axis=1)


def _overlap(content: FusionContent, measured: Sequence[str]) -> list[Html]:
    run = best_run(content.found)
    bins = np.digitize(content.overlap, OVERLAP_EDGES)
    groups = {
        label: _errors(content.found[run])[bins == b]
        for b, label in enumerate(OVERLAP_BINS)
        if (bins == b).any()
    }
    return [
        overlap_table(content.rows, measured),
        paragraph("Success, median position error, median heading error.", kind="note"),
        figure(
            violin_chart(groups, (_POSITION, _HEADING, _IOU)),
            f"Estimated relative pose, {TITLES[run[1]].removeprefix('+ ')}, by overlap.",
            alt="Errors by overlap",
        ),
    ]


def _verdict(content: FusionContent, measured: Sequence[str]) -> list[Html]:
    return [
        paragraph(
            f"Wrong is an error above {WRONG_M:g} m or {math.degrees(WRONG_RAD):.0f}°. What is not accepted "
            "is uncertain, or was not fused because the robot was not found."
        ),
        verdict_table(content.rows, measured),
    ]


def _gallery(content: FusionContent) -> list[Html]:
    if not content.gallery:
        return []
    words = (
        "Red: map 0. Blue: map 1 where the transform puts it. Violet: walls of both. The black robot is "
        "where robot 1 stands, the blue one where it is put."
    )
    shown = [joined(subheading(each.why.capitalize()), rendezvous_html(each)) for each in content.gallery]
    return [paragraph(words), *shown]


def _scenario(content: FusionContent) -> list[Html]:
    if content.scenario is None:
        return []
    return [
        paragraph(
            "In the paper both maps have 384 × 384 cells of 0.05 m and overlap by "
            f"{PAPER_OVERLAP:g}, and T_m0_m1 is (6.0 m, −5.8 m, 180°). Its maps are not public: of the pairs "
            "measured here, the one of most similar overlap stands in, its frame m1 chosen so that T_m0_m1 "
            "is exactly that, both maps drawn on such canvases."
        ),
        scenario_table(content.scenario.outcome),
        rendezvous_html(content.scenario),
    ]


def _origin(content: FusionContent) -> Html:
    c = content.conditions
    return origin_table(
        [
            ("dataset", f"{content.dataset}, split {c.split}"),
            ("digest of the images", c.data_digest),
            *((f"weights, {name}", digest) for name, digest in c.weights.items()),
            ("commit", c.commit or "not known"),
            ("hardware", c.hardware),
            *content.versions.items(),
        ]
    )
