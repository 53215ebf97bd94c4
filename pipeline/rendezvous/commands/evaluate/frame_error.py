"""Measure estimators of the frame error on published pairs, and report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from rendezvous.alignment.window import PAPER_XY_M, PAPER_YAW_RAD
from rendezvous.commands.evaluate.measured_pairs import Trial, measured, perturbation_json
from rendezvous.commands.evaluate.recorded_rows import RecordedRows
from rendezvous.commands.evaluate.report_folder import PAGE, keep_evaluation, kept_metrics
from rendezvous.errors import ConfigError, StoreError
from rendezvous.evaluation.frame_error.estimates import Outcomes, Pairs
from rendezvous.evaluation.frame_error.gallery import Panel, Shown, attention_panel, chosen_pairs, panels
from rendezvous.evaluation.frame_error.measured_row import Conditions, MeasuredRow, Training
from rendezvous.evaluation.frame_error.report import FrameErrorContent, frame_error_part
from rendezvous.evaluation.frame_error.summary import comparisons, ranking, summary
from rendezvous.evaluation.frame_error.symmetry import WIDE_RANGE_DEG, Symmetry, turn_symmetry
from rendezvous.evaluation.frame_error.table_one import METHODS, model_of
from rendezvous.evaluation.statistics import resample_weights
from rendezvous.geometry.se2 import Array
from rendezvous.resources import METRICS
from rendezvous.seeds import stream
from rendezvous.stages.weights.estimators import (
    Method,
    chosen_methods,
    plans_trained_on,
    trained,
    training_of,
)
from rendezvous.stages.weights.provenance import commit, hardware, versions
from rendezvous.store.disk import Disk
from rendezvous.store.read import StageReader
from rendezvous.store.records import digest_of
from rendezvous.training.frame_error.pairs import SPLIT_NAMES, PairTable, read_pairs
from rendezvous.training.frame_error.perturbation import PerturbationRange, perturbed_pair

if TYPE_CHECKING:
    from rendezvous.stages.weights.trained_estimators import Trained

PERTURBATIONS = "perturbations.json"
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
class Evaluation:
    """What to measure.

    Attributes:
        dataset: folder that `pack` wrote.
        split: of it.
        count: at most so many pairs, drawn at random; None for all.
        methods: of `METHODS`; none for all that need no weights or have some.
        weights: where those of some methods lie.
        xy_range_m, yaw_range_deg: half widths of the frame errors, drawn uniformly.
        seed: of frame errors, window headings and the draw of pairs.
        folder: of the report.
        workers: processes.
        records: folder of recorded rows.
        record: whether to keep what is measured now among them.
        console: where to tell.
    """

    dataset: str = "data/dataset"
    split: str = "test"
    count: int | None = None
    methods: tuple[str, ...] = ()
    weights: Mapping[str, Path] = field(default_factory=dict)
    xy_range_m: float = PAPER_XY_M
    yaw_range_deg: float = math.degrees(PAPER_YAW_RAD)
    seed: int = 0
    folder: Path = Path("report")
    workers: int = 1
    records: Path = RECORDS
    record: bool = False
    console: Console = field(default_factory=lambda: Console(stderr=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Contender:
    """A method that is ready to be measured; without a network, all else is None."""

    method: Method
    network: Trained | None
    training: Training | None
    plans_trained_on: int | None


def evaluate(settings: Evaluation) -> Path:
    """Measure, record if asked to, and write the report.

    Returns:
        The page.

    Raises:
        StoreError: the dataset, weights or recorded rows are missing or damaged, or nothing can be written.
        ConfigError: a split, method or range that there is not, weights of another model, or a recorded row
            of more pairs.
        SetupError: a package is missing.
    """
    if settings.split not in SPLIT_NAMES:
        raise ConfigError(f"--split is {settings.split!r}; must be one of {', '.join(SPLIT_NAMES)}")
    range_ = _range(settings)
    methods = chosen_methods(
        settings.methods, settings.weights, xy_range_m=range_.xy_m, yaw_range_rad=range_.yaw_rad
    )
    pairs = read_pairs(StageReader(settings.dataset, "pack"), settings.split)
    trial = Trial.of(pairs, _drawn(pairs, settings), range_, seed=settings.seed)
    # All that can be wrong with files shows here, and not after an hour of measuring.
    kept_metrics(Disk(str(settings.folder)))
    contenders = _contenders(methods, trial, settings)
    conditions, recorded = _conditions(trial, settings), RecordedRows.read(settings.records)
    if settings.record:
        recorded.require_no_loss(contenders, conditions)
    found = {name: _measured(contender, trial, settings) for name, contender in contenders.items()}
    content = _content(trial, conditions, contenders, found, recorded, settings)
    if settings.record:
        recorded.keep((content.rows[name] for name in found), settings.console)
    _write(content, trial, settings)
    return settings.folder / PAGE


def _range(settings: Evaluation) -> PerturbationRange:
    """Of the frame errors, as the options give it."""
    xy_m, yaw_deg = settings.xy_range_m, settings.yaw_range_deg
    for option, value, most in (("--xy-range-m", xy_m, MOST_XY_M), ("--yaw-range-deg", yaw_deg, 180.0)):
        if not 0.0 <= value <= most:
            raise ConfigError(f"{option} is {value:g}; must be from 0 to {most:g}")
    return PerturbationRange(xy_m=xy_m, yaw_rad=math.radians(yaw_deg))


def _drawn(pairs: PairTable, settings: Evaluation) -> Sequence[int]:
    """Indices of the pairs to measure, in order; a larger draw holds a smaller one."""
    order = stream(settings.seed, "evaluation", "pairs").permutation(len(pairs))
    return sorted(int(index) for index in order[: settings.count])


def _contenders(methods: Sequence[Method], trial: Trial, settings: Evaluation) -> dict[str, _Contender]:
    """By name. A method that was not asked for, and whose weights happen to lie in `runs/`, is left out if
    these cannot be used."""
    asked = {*settings.methods, *settings.weights}
    contenders = {}
    for method in methods:
        try:
            contenders[method.name] = _contender(method, trial, settings)
        except (ConfigError, StoreError) as error:
            if {method.name, model_of(method.name)} & asked:
                raise
            settings.console.print(
                f"evaluate: left out {method.name}: {error}", highlight=False, soft_wrap=True, markup=False
            )
    return contenders


def _contender(method: Method, trial: Trial, settings: Evaluation) -> _Contender:
    """Load what there is to load, and tell if it knows the test already."""
    if not method.learned:
        return _Contender(method=method, network=None, training=None, plans_trained_on=None)
    network = trained(method, threads=settings.workers)
    training = training_of(method, network.record)
    plans = dict(zip(trial.column("plan_id"), trial.column("plan_digest"), strict=True))
    known = plans_trained_on(network.record, plans)
    if known:
        settings.console.print(
            f"evaluate {method.name}: warning: trained on {known} of these {len(plans)} floor plans; its "
            "errors on plans that it never saw may be larger than these",
            highlight=False,
            soft_wrap=True,
        )
    return _Contender(method=method, network=network, training=training, plans_trained_on=known)


def _measured(contender: _Contender, trial: Trial, settings: Evaluation) -> Outcomes:
    return measured(
        contender.method,
        None if contender.network is None else contender.network.estimator,
        trial,
        folder=settings.folder,
        workers=settings.workers,
        console=settings.console,
    )


def _content(
    trial: Trial,
    conditions: Conditions,
    contenders: Mapping[str, _Contender],
    found: Mapping[str, Outcomes],
    recorded: RecordedRows,
    settings: Evaluation,
) -> FrameErrorContent:
    pairs = Pairs.of(np.array(trial.column("overlap")), trial.column("plan_id"))
    weights = resample_weights(pairs.plan, rng=stream(settings.seed, "evaluation", "bootstrap"))
    rows = recorded.beside(conditions) | {
        name: MeasuredRow(
            method=name,
            conditions=conditions,
            summary=summary(outcomes, pairs, weights),
            training=contenders[name].training,
            plans_trained_on=contenders[name].plans_trained_on,
        )
        for name, outcomes in found.items()
    }
    gallery, attention = _pictures(trial, contenders, found, pairs)
    return FrameErrorContent(
        conditions=conditions,
        found=found,
        rows={name: rows[name] for name in METHODS if name in rows},
        pairs=pairs,
        symmetry=_symmetry(trial, found, weights, settings),
        comparisons=comparisons(found, weights),
        gallery=gallery,
        attention=attention,
        dataset=settings.dataset,
        versions=versions(_PACKAGES),
    )


def _symmetry(
    trial: Trial, found: Mapping[str, Outcomes], weights: Array, settings: Evaluation
) -> Symmetry | None:
    """What symmetric scenes do to methods, if frame errors reach far enough."""
    if settings.yaw_range_deg < WIDE_RANGE_DEG:
        return None
    share = np.array([turn_symmetry(trial[number][0].grid_1) for number in range(len(trial.indices))])
    return Symmetry.of(share, found, weights)


def _pictures(
    trial: Trial, contenders: Mapping[str, _Contender], found: Mapping[str, Outcomes], pairs: Pairs
) -> tuple[list[Shown], dict[str, list[Panel]]]:
    """The gallery, and what networks look at in its pairs."""
    # Without a correction a pair is as it was given, which is drawn already.
    drawn = {name: outcomes for name, outcomes in found.items() if name != "identity"}
    gallery: list[Shown] = []
    attention: dict[str, list[Panel]] = {}
    for chosen in chosen_pairs(found[ranking(found)[0]], pairs):
        pair, perturbation = trial[chosen.index]
        sample = perturbed_pair(pair, perturbation)
        shown = panels(pair, sample, drawn, chosen.index)
        gallery.append(Shown(pair_id=pair.pair_id, why=chosen.why, overlap=pair.overlap, panels=tuple(shown)))
        for name, contender in contenders.items():
            if contender.network is not None and contender.network.attention is not None:
                picture = attention_panel(sample.window, contender.network.attention(sample.window))
                panel = Panel(name=chosen.why, image=picture, position_m=None, heading_rad=None)
                attention.setdefault(name, []).append(panel)
    return gallery, attention


def _write(content: FrameErrorContent, trial: Trial, settings: Evaluation) -> None:
    disk = Disk(str(settings.folder))
    told = {
        "conditions": asdict(content.conditions),
        "methods": {
            name: {**row.to_json(), "source": "measured" if name in content.found else "recorded"}
            for name, row in content.rows.items()
        },
        "symmetry": content.symmetry and content.symmetry.to_json(),
        "comparisons": [comparison.to_json() for comparison in content.comparisons],
    }
    disk.write(PERTURBATIONS, perturbation_json(trial.drawn()))
    keep_evaluation(disk, frame_error_part(content), told, settings.console)


def _conditions(trial: Trial, settings: Evaluation) -> Conditions:
    return Conditions(
        split=settings.split,
        pairs=len(trial.indices),
        plans=len(set(trial.column("plan_id"))),
        data_digest=trial.data_digest(),
        perturbation_digest=digest_of(trial.drawn()),
        seed=settings.seed,
        xy_range_m=settings.xy_range_m,
        yaw_range_deg=settings.yaw_range_deg,
        commit=commit(),
        hardware=hardware(),
    )
