"""Measure estimators of the frame error on published pairs, and report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from rendezvous.alignment.estimate import FrameErrorEstimator
from rendezvous.alignment.window import PAPER_XY_M, PAPER_YAW_RAD, SearchRange
from rendezvous.commands.evaluate.kept import PAGE, RecordFolder, keep_evaluation, kept_metrics, with_sources
from rendezvous.commands.evaluate.measured_pairs import Trial, measurement
from rendezvous.commands.evaluate.measuring import EvaluationSettings, measured
from rendezvous.errors import ConfigError, StoreError
from rendezvous.evaluation.frame_error.estimates import Outcome, outcome_table
from rendezvous.evaluation.frame_error.gallery import Panel, Shown, attention_panel, chosen_pairs, panels
from rendezvous.evaluation.frame_error.measured_row import MeasuredRow, PairConditions
from rendezvous.evaluation.frame_error.report import FrameErrorContent, frame_error_part
from rendezvous.evaluation.frame_error.summary import comparisons, ranking, summary
from rendezvous.evaluation.frame_error.symmetry import WIDE_RANGE_DEG, Symmetry, turn_symmetry
from rendezvous.evaluation.frame_error.training_curve import Training
from rendezvous.evaluation.statistics import resample_weights
from rendezvous.geometry.se2 import Array
from rendezvous.methods import METHODS, Method
from rendezvous.resources import METRICS
from rendezvous.seeds import stream
from rendezvous.stages.weights.estimators import (
    SelectedMethod,
    plans_trained_on,
    select_methods,
    trained,
    training_of,
)
from rendezvous.stages.weights.provenance import commit, hardware, versions
from rendezvous.store.disk import Disk
from rendezvous.store.read import StageReader
from rendezvous.store.records import digest_of, json_bytes
from rendezvous.training.frame_error.pairs import PairTable, PerturbationRange, perturbed_pair, read_pairs

if TYPE_CHECKING:
    from rendezvous.stages.weights.trained_estimators import Trained

PERTURBATIONS = "perturbations.json"
_ABOUT_PERTURBATIONS = (
    "theta_c: frame error x [m], y [m], yaw [rad] at the meeting point, in the axes of m0; "
    "rotation_rad: heading of the window in m0"
)
MOST_XY_M = 8.0
"""Frame errors of more would put map 1 out of the window."""
RECORDS = METRICS
_PACKAGES = (
    "rendezvous-fusion",
    "numpy",
    "scipy",
    "opencv-python-headless",
    "numba",
    "pyarrow",
    "matplotlib",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation(EvaluationSettings):
    """An evaluation of frame-error estimators."""

    count: int | None = None  # at most this many pairs, drawn at random; None for all
    # Names of shipped and installed methods, or `package.module:Class`; none for all that need no weights or
    # whose weights are found.
    methods: tuple[str, ...] = ()
    own: Mapping[str, Method] = field(default_factory=dict)  # further methods by name, which always run
    weights: Mapping[str, Path] = field(default_factory=dict)  # files of some networks' weights
    # xy_range_m, yaw_range_deg: half widths of the frame errors' uniform distribution.
    xy_range_m: float = PAPER_XY_M
    yaw_range_deg: float = math.degrees(PAPER_YAW_RAD)
    records: Path = RECORDS  # folder of recorded rows
    record: bool = False  # whether to record this run's rows there


@dataclass(frozen=True, slots=True, kw_only=True)
class _Contender:
    """A method that is ready to be measured; what concerns its network is None if it has none."""

    selected: SelectedMethod
    network: Trained | None = None
    training: Training | None = None
    plans_trained_on: int | None = None

    @property
    def estimator(self) -> FrameErrorEstimator | None:
        """The loaded network."""
        return None if self.network is None else self.network.estimator


def evaluate(settings: Evaluation) -> Path:
    """As `measure_and_report`; returns the page."""
    measure_and_report(settings)
    return settings.folder / PAGE


def measure_and_report(settings: Evaluation) -> pd.DataFrame:
    """Measure, record if asked to, and write the report.

    Returns:
        The `outcome_table` of this run.

    Raises:
        StoreError: the dataset, weights or recorded rows are missing or damaged, or nothing can be written.
        ConfigError: a split, method or range does not exist, weights are another model's, or a recorded row
            has more pairs.
        SetupError: a package is missing.
    """
    settings.require_split()
    range_ = _range(settings)
    search = SearchRange.covering(xy_m=range_.xy_m, yaw_rad=range_.yaw_rad)
    methods = select_methods(settings.methods, settings.weights, search=search, own=settings.own)
    pairs = read_pairs(StageReader(settings.dataset, "pack"), settings.split)
    trial = Trial.of(pairs, _drawn(pairs, settings), range_, seed=settings.seed)
    # Whatever is wrong with files shows here, and not after an hour of measuring.
    kept_metrics(Disk(str(settings.folder)))
    contenders = _contenders(methods, trial, settings)
    conditions = _conditions(trial, settings)
    recorded = RecordFolder.read(settings.records, MeasuredRow, command="evaluate")
    if settings.record:
        recorded.require_no_loss(contenders, conditions)
    found = {
        name: measured(measurement(contender.selected, contender.estimator, trial), trial, settings)
        for name, contender in contenders.items()
    }
    content = _content(trial, conditions, contenders, found, recorded, settings)
    if settings.record:
        recorded.keep((content.rows[name] for name in found), settings.console)
    _write(content, trial, settings)
    return content.outcomes


def _range(settings: Evaluation) -> PerturbationRange:
    """The range of the frame errors that the options give."""
    xy_m, yaw_deg = settings.xy_range_m, settings.yaw_range_deg
    for option, value, most in (("--xy-range-m", xy_m, MOST_XY_M), ("--yaw-range-deg", yaw_deg, 180.0)):
        if not 0.0 <= value <= most:
            raise ConfigError(f"{option} is {value:g}; must be from 0 to {most:g}")
    return PerturbationRange(xy_m=xy_m, yaw_rad=math.radians(yaw_deg))


def _drawn(pairs: PairTable, settings: Evaluation) -> Sequence[int]:
    """Indices of the pairs to measure, in order; a larger draw holds a smaller one."""
    order = stream(settings.seed, "evaluation", "pairs").permutation(len(pairs))
    return sorted(int(index) for index in order[: settings.count])


def _contenders(
    methods: Sequence[SelectedMethod], trial: Trial, settings: Evaluation
) -> dict[str, _Contender]:
    """Methods by name. A network that nobody asked for is left out if its weights cannot be used."""
    asked = {*settings.methods, *settings.weights}
    contenders = {}
    for selected in methods:
        try:
            contenders[selected.name] = _contender(selected, trial, settings)
        except (ConfigError, StoreError) as error:
            if {selected.name, selected.method.model} & asked:
                raise
            settings.console.print(
                f"evaluate: left out {selected.name}: {error}", highlight=False, soft_wrap=True, markup=False
            )
    return contenders


def _contender(selected: SelectedMethod, trial: Trial, settings: Evaluation) -> _Contender:
    """Load a method's network, if it has one, and warn if that was trained on the measured plans."""
    if not selected.method.needs_weights:
        return _Contender(selected=selected)
    network = trained(selected, threads=settings.workers)
    training = training_of(selected, network.record)
    plans = dict(zip(trial.column("plan_id"), trial.column("plan_digest"), strict=True))
    known = plans_trained_on(network.record, plans)
    settings.warn_of_known_plans(selected.name, known, len(plans))
    return _Contender(selected=selected, network=network, training=training, plans_trained_on=known)


def _content(
    trial: Trial,
    conditions: PairConditions,
    contenders: Mapping[str, _Contender],
    found: Mapping[str, Sequence[Outcome]],
    recorded: RecordFolder[MeasuredRow],
    settings: Evaluation,
) -> FrameErrorContent:
    outcomes = outcome_table(found, np.array(trial.column("overlap")))
    _, plans = np.unique(trial.column("plan_id"), return_inverse=True)
    weights = resample_weights(plans, rng=stream(settings.seed, "evaluation", "bootstrap"))
    rows = {row.name: row for row in recorded.rows.values() if row.conditions.comparable(conditions)}
    for name, group in outcomes.groupby("method", sort=False):
        contender = contenders[str(name)]
        rows[str(name)] = MeasuredRow(
            method=str(name),
            conditions=conditions,
            summary=summary(group, weights),
            training=contender.training,
            plans_trained_on=contender.plans_trained_on,
        )
    methods = {**METHODS, **{name: contender.selected.method for name, contender in contenders.items()}}
    gallery, attention = _pictures(trial, contenders, outcomes)
    return FrameErrorContent(
        conditions=conditions,
        methods=methods,
        outcomes=outcomes,
        rows={name: rows[name] for name in methods if name in rows},
        symmetry=_symmetry(trial, outcomes, weights, settings),
        comparisons=comparisons(outcomes, weights),
        gallery=gallery,
        attention=attention,
        dataset=settings.dataset,
        versions=versions(_PACKAGES),
    )


def _symmetry(trial: Trial, outcomes: pd.DataFrame, weights: Array, settings: Evaluation) -> Symmetry | None:
    """Errors on symmetric scenes, if frame errors are large enough to confuse them."""
    if settings.yaw_range_deg < WIDE_RANGE_DEG:
        return None
    share = np.array([turn_symmetry(trial[number][0].grid_1) for number in range(len(trial))])
    return Symmetry.of(share, outcomes, weights)


def _pictures(
    trial: Trial, contenders: Mapping[str, _Contender], outcomes: pd.DataFrame
) -> tuple[list[Shown], dict[str, list[Panel]]]:
    """The gallery, and what networks attend to in its pairs."""
    # Without a correction a pair is as it was given, which is drawn already.
    drawn = outcomes[outcomes["method"] != "identity"]
    gallery: list[Shown] = []
    attention: dict[str, list[Panel]] = {}
    for why, index in chosen_pairs(outcomes[outcomes["method"] == ranking(outcomes)[0]]):
        pair, perturbation = trial[index]
        sample = perturbed_pair(pair, perturbation)
        shown = tuple(panels(pair, sample, drawn[drawn.index == index]))
        gallery.append(Shown(pair_id=pair.pair_id, why=why, overlap=pair.overlap, panels=shown))
        for name, contender in contenders.items():
            if contender.network is not None and contender.network.attention is not None:
                picture = attention_panel(sample.window, contender.network.attention(sample.window))
                panel = Panel(name=why, image=picture)
                attention.setdefault(name, []).append(panel)
    return gallery, attention


def _write(content: FrameErrorContent, trial: Trial, settings: Evaluation) -> None:
    disk = Disk(str(settings.folder))
    figures = {
        "conditions": asdict(content.conditions),
        "methods": with_sources(content.rows, content.measured),
        "symmetry": content.symmetry and content.symmetry.to_json(),
        "comparisons": [comparison.to_json() for comparison in content.comparisons],
    }
    disk.write(PERTURBATIONS, json_bytes({"about": _ABOUT_PERTURBATIONS, "pairs": trial.drawn()}))
    keep_evaluation(disk, frame_error_part(content), figures, settings.console)


def _conditions(trial: Trial, settings: Evaluation) -> PairConditions:
    return PairConditions(
        split=settings.split,
        pairs=len(trial),
        plans=len(set(trial.column("plan_id"))),
        data_digest=trial.pairs.digest(),
        perturbation_digest=digest_of(trial.drawn()),
        seed=settings.seed,
        xy_range_m=settings.xy_range_m,
        yaw_range_deg=settings.yaw_range_deg,
        commit=commit(),
        hardware=hardware(),
    )
