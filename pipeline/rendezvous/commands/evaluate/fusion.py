"""Measure the whole system, one image and two maps in, one map out, and write its part of the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rendezvous.commands.evaluate.images import (
    ImageEvaluation,
    image_conditions,
    require_robot_of_images,
    unseen_images,
)
from rendezvous.commands.evaluate.kept import PAGE, RecordFolder, keep_evaluation, kept_metrics, with_sources
from rendezvous.commands.evaluate.measured_fusions import (
    FusionCase,
    FusionCases,
    FusionSetup,
    measured_fusions,
    run_case,
)
from rendezvous.errors import ConfigError, StoreError
from rendezvous.evaluation.fusion.gallery import FusionShown, best_run, chosen_rendezvous, fusion_shown
from rendezvous.evaluation.fusion.paper_scenario import PAPER_OVERLAP, scenario
from rendezvous.evaluation.fusion.report import FusionContent, fusion_part
from rendezvous.evaluation.fusion.runs import (
    AUTO,
    ESTIMATED,
    METHODS,
    RendezvousOutcome,
    run_name,
    runs_of,
)
from rendezvous.evaluation.fusion.summary import FusionFigures, fusion_figures, fusion_table
from rendezvous.evaluation.report.recorded_figures import ImageConditions, RecordedFigures
from rendezvous.methods import REFINEMENTS
from rendezvous.resources import METRICS
from rendezvous.seeds import stream
from rendezvous.stages.training.seen_images import SIGHTING, read_images
from rendezvous.stages.weights.estimators import plans_trained_on, selected_matcher, trained
from rendezvous.stages.weights.pose_source import PoseWeights
from rendezvous.stages.weights.provenance import versions
from rendezvous.store.disk import Disk
from rendezvous.store.read import StageReader
from rendezvous.training.frame_error.pairs import read_pairs

FUSION_RECORDS = METRICS / "fusion"
_PACKAGES = ("rendezvous-fusion", "numpy", "scipy", "opencv-python-headless", "numba", "torch", "pyarrow")


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionEvaluation(ImageEvaluation):
    """What to measure."""

    count: int | None = None  # largest number of rendezvous, drawn at random; None for all
    methods: tuple[str, ...] = ()  # of `runs.METHODS`; empty for all that can run
    records: Path = FUSION_RECORDS


def evaluate_fusion(settings: FusionEvaluation) -> Path:
    """Measure, record if asked to, and write the report.

    Returns:
        Path of the page.

    Raises:
        StoreError: the dataset, its images, weights or recorded figures are missing or damaged, or nothing
            can be written.
        ConfigError: there is no such split or method, or recorded figures are of more rendezvous.
        SetupError: a package is missing.
    """
    settings.require_split()
    cases = _cases(settings)
    # Whatever is wrong with files shows here, not after an hour of measuring.
    disk = Disk(str(settings.folder))
    kept_metrics(disk)
    setup = _setup(settings)
    setup.source.estimator(floor=True)
    require_robot_of_images(cases.images, setup.source, settings.dataset)
    setup.refiners()
    if settings.unseen:
        cases = _unseen(cases, setup, settings)
    conditions = _conditions(cases, setup, settings)
    recorded = RecordFolder.read(settings.records, RecordedFigures[FusionFigures], command="evaluate-fusion")
    names = [run_name(run) for run in runs_of(setup.methods)]
    if settings.record:
        recorded.require_no_loss(names, conditions)
    outcomes = measured_fusions(setup, cases, settings)
    content = _content(cases, setup, conditions, outcomes, recorded, settings)
    if settings.record:
        recorded.keep((content.rows[name] for name in names), settings.console)
    keep_evaluation(disk, fusion_part(content), _metrics(content), settings.console)
    return settings.folder / PAGE


def _cases(settings: FusionEvaluation) -> FusionCases:
    """The rendezvous to measure, whose images show robot 1."""
    reader = StageReader(settings.dataset, "pack")
    pairs = read_pairs(reader, settings.split)
    images = read_images(reader, settings.split, kinds=(SIGHTING,))
    by_id = {image.truth.image_id: image for image in images if image.truth.T_r0_r1 is not None}
    ids = pairs.table["pair_id"].to_pylist()
    order = stream(settings.seed, "evaluation", "pairs").permutation(len(pairs))
    drawn = sorted([int(index) for index in order if ids[index] in by_id][: settings.count])
    if not drawn:
        raise StoreError(f"{settings.dataset}: no image of split {settings.split} shows the other robot")
    return FusionCases(pairs=pairs, indices=tuple(drawn), images=tuple(by_id[ids[index]] for index in drawn))


def _unseen(cases: FusionCases, setup: FusionSetup, settings: FusionEvaluation) -> FusionCases:
    """The rendezvous on floor plans that no weights were trained on."""
    records: list[Mapping[str, Any]] = [setup.source.record()]
    if setup.matcher is not None:
        records.append(trained(setup.matcher, threads=1).record)
    kept = {i.truth.image_id for i in unseen_images(cases.images, records, settings.console)}
    both = [
        (index, image)
        for index, image in zip(cases.indices, cases.images, strict=True)
        if image.truth.image_id in kept
    ]
    indices, images = zip(*both, strict=True)
    return replace(cases, indices=indices, images=images)


def _setup(settings: FusionEvaluation) -> FusionSetup:
    """The runs; without a matcher, learned methods that were not asked for are left out."""
    for name in settings.methods:
        if name not in METHODS:
            raise ConfigError(f"method {name!r} is unknown; must be one of {', '.join(METHODS)}")
    asked = settings.methods or METHODS
    learned = [name for name, way in REFINEMENTS.items() if way.needs_matcher]
    source = settings.source or PoseWeights.found(settings.weights)
    try:
        matcher = selected_matcher() if set(asked) & set(learned) else None
    except ConfigError as error:
        if settings.methods:
            raise
        settings.console.print(f"evaluate-fusion: {', '.join(learned)} left out: {error}", highlight=False)
        matcher, asked = None, tuple(name for name in METHODS if name not in learned)
    return FusionSetup(
        source=source, methods=tuple(name for name in METHODS if name in asked), matcher=matcher
    )


def _conditions(cases: FusionCases, setup: FusionSetup, settings: FusionEvaluation) -> ImageConditions:
    conditions = image_conditions(cases.images, setup.source, settings)
    if setup.matcher is None:
        return conditions
    plans = {image.truth.plan_id: image.plan_digest for image in cases.images}
    conditions.weights["matcher"] = setup.matcher.weights_digest()
    conditions.trained_on["matcher"] = plans_trained_on(trained(setup.matcher, threads=1).record, plans)
    return conditions


def _content(
    cases: FusionCases,
    setup: FusionSetup,
    conditions: ImageConditions,
    outcomes: Sequence[RendezvousOutcome],
    recorded: RecordFolder[RecordedFigures[FusionFigures]],
    settings: FusionEvaluation,
) -> FusionContent:
    table = fusion_table(outcomes, cases.overlap)
    runs = {
        (source, method): rows for (source, method), rows in table.groupby(["source", "method"], sort=False)
    }
    best = best_run(table, (ESTIMATED, AUTO))
    rows = recorded.of_split(settings.split) | {
        run_name(run): RecordedFigures(
            name=run_name(run), conditions=conditions, figures=fusion_figures(found)
        )
        for run, found in runs.items()
    }
    return FusionContent(
        conditions=conditions,
        found=table,
        best=best,
        rows={name: rows[name] for name in map(run_name, runs_of(METHODS)) if name in rows},
        gallery=[
            fusion_shown(why, cases[number].pair, outcomes[number], [best])
            for why, number in chosen_rendezvous(runs[best])
        ],
        scenario=_scenario(cases, setup),
        dataset=settings.dataset,
        versions=versions(_PACKAGES),
    )


def _scenario(cases: FusionCases, setup: FusionSetup) -> FusionShown | None:
    """The paper's scenario, on the pair of most similar overlap that fits it."""
    for number in np.argsort(np.abs(cases.overlap - PAPER_OVERLAP), kind="stable"):
        pair = scenario(cases[int(number)].pair)
        if pair is not None:
            outcome = run_case(setup, FusionCase(pair=pair, image=cases.images[number]))
            drawn = [run for run in runs_of(setup.methods) if run[0] == ESTIMATED]
            return fusion_shown("paper's scenario", pair, outcome, drawn)
    return None


def _metrics(content: FusionContent) -> dict[str, Any]:
    """The entry in `metrics.json`."""
    scenario = content.scenario
    return {
        "conditions": asdict(content.conditions),
        "runs": with_sources(content.rows, content.measured),
        "paper_scenario": scenario and {"overlap": scenario.overlap, **scenario.outcome.to_json()},
    }
