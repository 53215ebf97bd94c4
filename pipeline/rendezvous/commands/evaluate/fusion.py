"""Measure the whole system on published rendezvous: one image and two maps in, one map out; and report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from rendezvous.alignment.window import PAPER_XY_M, PAPER_YAW_RAD
from rendezvous.commands.evaluate.measured_fusions import (
    LEARNED,
    FusionCase,
    FusionCases,
    FusionSetup,
    measured_fusions,
    run_case,
)
from rendezvous.commands.evaluate.recorded_figures import FiguresFolder
from rendezvous.commands.evaluate.relative_pose import (
    image_conditions,
    require_robot_of_images,
    require_split,
    unseen_images,
)
from rendezvous.commands.evaluate.report_folder import PAGE, keep_evaluation, kept_metrics
from rendezvous.errors import ConfigError, StoreError
from rendezvous.evaluation.fusion.gallery import FusionShown, fusion_shown
from rendezvous.evaluation.fusion.paper_scenario import PAPER_OVERLAP, scenario
from rendezvous.evaluation.fusion.report import FusionContent, chosen_rendezvous, fusion_part, run_name
from rendezvous.evaluation.fusion.runs import ESTIMATED, METHODS, RendezvousOutcome, Run, runs_of
from rendezvous.evaluation.fusion.summary import FusionFigures, FusionOutcomes, fusion_figures
from rendezvous.evaluation.report.recorded_figures import ImageConditions, RecordedFigures
from rendezvous.resources import METRICS
from rendezvous.seeds import stream
from rendezvous.stages.training.seen_images import SIGHTING, read_images
from rendezvous.stages.weights.estimators import Method, chosen_methods, plans_trained_on, trained
from rendezvous.stages.weights.pose_source import PoseSource, PoseWeights
from rendezvous.stages.weights.provenance import versions
from rendezvous.store.disk import Disk
from rendezvous.store.read import StageReader
from rendezvous.training.frame_error.pairs import read_pairs

FUSION_RECORDS = METRICS / "fusion"
_PACKAGES = ("rendezvous-fusion", "numpy", "scipy", "opencv-python-headless", "numba", "torch", "pyarrow")


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionEvaluation:
    """What to measure.

    Attributes:
        dataset: folder that `pack` wrote.
        split: of it.
        count: at most so many rendezvous, drawn at random; None for all.
        methods: of `fusion_runs.METHODS`; none for all that can run.
        weights: of the relative pose; None for those of `runs/`, then the shipped ones.
        seed: of the draw of rendezvous.
        folder: of the report.
        workers: processes.
        records: folder of recorded figures.
        record: whether to keep what is measured now among them.
        unseen: whether to leave out floor plans that the weights were trained on.
        source: what makes the estimator of the relative pose, instead of weights.
        console: where to tell.
    """

    dataset: str = "data/dataset"
    split: str = "test"
    count: int | None = None
    methods: tuple[str, ...] = ()
    weights: Path | None = None
    seed: int = 0
    folder: Path = Path("report")
    workers: int = 1
    records: Path = FUSION_RECORDS
    record: bool = False
    unseen: bool = False
    source: PoseSource | None = None
    console: Console = field(default_factory=lambda: Console(stderr=True))


def evaluate_fusion(settings: FusionEvaluation) -> Path:
    """Measure, record if asked to, and write the report.

    Returns:
        The page.

    Raises:
        StoreError: the dataset, its images, weights or recorded figures are missing or damaged, or nothing
            can be written.
        ConfigError: a split or method that there is not, or recorded figures of more rendezvous.
        SetupError: a package is missing.
    """
    require_split(settings.split)
    cases = _cases(settings)
    # All that can be wrong with files shows here, and not after an hour of measuring.
    disk = Disk(str(settings.folder))
    kept_metrics(disk)
    setup = _setup(settings)
    setup.source.estimator(floor=True)
    require_robot_of_images(cases.images, setup.source, settings.dataset)
    setup.refiners()
    if settings.unseen:
        cases = _unseen(cases, setup, settings)
    conditions = _conditions(cases, setup, settings)
    recorded = FiguresFolder.read(settings.records, FusionFigures, command="evaluate-fusion")
    names = [run_name(run) for run in runs_of(setup.methods)]
    if settings.record:
        recorded.require_no_loss(names, conditions)
    outcomes = measured_fusions(
        setup,
        cases,
        folder=settings.folder,
        workers=settings.workers,
        console=settings.console,
    )
    content = _content(cases, setup, conditions, outcomes, recorded, settings)
    if settings.record:
        recorded.keep((content.rows[name] for name in names), settings.console)
    keep_evaluation(disk, fusion_part(content), _told(content), settings.console)
    return settings.folder / PAGE


def _cases(settings: FusionEvaluation) -> FusionCases:
    """The rendezvous to measure: those whose image shows robot 1."""
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
    """What can run; learned methods that nobody asked for are left out where there is no matcher."""
    for name in settings.methods:
        if name not in METHODS:
            raise ConfigError(f"method {name!r} is unknown; must be one of {', '.join(METHODS)}")
    asked = settings.methods or METHODS
    source = settings.source or PoseWeights.found(settings.weights)
    try:
        matcher = _matcher() if set(asked) & set(LEARNED) else None
    except ConfigError as error:
        if settings.methods:
            raise
        settings.console.print(f"evaluate-fusion: {', '.join(LEARNED)} left out: {error}", highlight=False)
        matcher, asked = None, tuple(name for name in METHODS if name not in LEARNED)
    return FusionSetup(
        source=source, methods=tuple(name for name in METHODS if name in asked), matcher=matcher
    )


def _matcher() -> Method:
    (method,) = chosen_methods(("matcher",), {}, xy_range_m=PAPER_XY_M, yaw_range_rad=PAPER_YAW_RAD)
    return method


def _conditions(cases: FusionCases, setup: FusionSetup, settings: FusionEvaluation) -> ImageConditions:
    conditions = image_conditions(
        cases.images, settings.split, settings.seed, {"relative pose": setup.source}, settings.console
    )
    if setup.matcher is None:
        return conditions
    plans = {image.truth.plan_id: image.plan_digest for image in cases.images}
    conditions.weights["matcher"] = setup.matcher.weights_digest()
    known = plans_trained_on(trained(setup.matcher, threads=1).record, plans)
    conditions.trained_on["matcher"] = known
    return conditions


def _content(
    cases: FusionCases,
    setup: FusionSetup,
    conditions: ImageConditions,
    outcomes: Sequence[RendezvousOutcome],
    recorded: FiguresFolder[FusionFigures],
    settings: FusionEvaluation,
) -> FusionContent:
    found = {run: FusionOutcomes.of(outcomes, run) for run in runs_of(setup.methods)}
    rows = recorded.of_split(settings.split) | {
        run_name(run): RecordedFigures(
            name=run_name(run), conditions=conditions, figures=fusion_figures(outcome, cases.overlap)
        )
        for run, outcome in found.items()
    }
    every_run = [run_name(run) for run in runs_of(METHODS)]
    return FusionContent(
        conditions=conditions,
        found=found,
        overlap=cases.overlap,
        rows={name: rows[name] for name in every_run if name in rows},
        gallery=_gallery(cases, outcomes, found),
        scenario=_scenario(cases, setup),
        dataset=settings.dataset,
        versions=versions(_PACKAGES),
    )


def _gallery(
    cases: FusionCases,
    outcomes: Sequence[RendezvousOutcome],
    found: Mapping[Run, FusionOutcomes],
) -> list[FusionShown]:
    return [
        fusion_shown(why, cases[number].pair, outcomes[number], [run])
        for why, number, run in chosen_rendezvous(found)
    ]


def _scenario(cases: FusionCases, setup: FusionSetup) -> FusionShown | None:
    """The paper's scenario, on the pair that comes nearest to it."""
    nearest = np.argsort(np.abs(cases.overlap - PAPER_OVERLAP), kind="stable")
    found = ((number, scenario(cases[int(number)].pair)) for number in nearest)
    number, pair = next(((n, pair) for n, pair in found if pair is not None), (0, None))
    if pair is None:
        return None
    outcome = run_case(setup, FusionCase(pair=pair, image=cases.images[number]))
    drawn = [run for run in runs_of(setup.methods) if run[0] == ESTIMATED]
    return fusion_shown("paper's scenario", pair, outcome, drawn)


def _told(content: FusionContent) -> dict[str, Any]:
    """What `metrics.json` holds."""
    measured = {run_name(run) for run in content.found}
    scenario = content.scenario
    return {
        "conditions": asdict(content.conditions),
        "runs": {
            name: {**row.to_json(), "source": "measured" if name in measured else "recorded"}
            for name, row in content.rows.items()
        },
        "paper_scenario": scenario and {"overlap": scenario.overlap, **scenario.outcome.to_json()},
    }
