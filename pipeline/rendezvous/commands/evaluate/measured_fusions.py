"""Measure what the whole system makes of rendezvous: image and maps in, fused maps out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any

from rich.console import Console

from rendezvous.alignment.window import DEFAULT_SEARCH, SearchRange
from rendezvous.baselines.hough import HoughSpectrum
from rendezvous.baselines.orb import OrbRansac
from rendezvous.commands.evaluate.measured_poses import POSE_CODE, POSE_PACKAGES
from rendezvous.commands.evaluate.measuring import Measurement, code_digest, measured
from rendezvous.evaluation.fusion.runs import METHODS, NONE, RendezvousOutcome, run_rendezvous
from rendezvous.fusion.prior import FrameErrorPrior
from rendezvous.fusion.refinement import Refiner, correlative_refiner, matcher_refiner
from rendezvous.geometry.se2 import Array
from rendezvous.stages.training.seen_images import SeenImage, digest_of_images
from rendezvous.stages.weights.estimators import Method, trained
from rendezvous.stages.weights.pose_source import PoseSource
from rendezvous.stages.weights.provenance import versions
from rendezvous.store.disk import Disk
from rendezvous.training.frame_error.pairs import MapPair, PairTable

CACHE = "fusion"
LEARNED = ("learned", "auto")
"""Methods that need the trained matcher."""

_ROOMS = (*POSE_CODE, "alignment", "baselines", "fusion", "training")
_FILES = (
    "evaluation/fusion/runs.py",
    "stages/weights/estimators.py",
    "commands/evaluate/measured_fusions.py",
    "stages/weights/pose_source.py",
    "stages/weights/pose_weights.py",
    "stages/training/seen_images.py",
    "stages/weights/trained_estimators.py",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionCase:
    """A rendezvous: its pair of maps, and what robot 0 saw."""

    pair: MapPair
    image: SeenImage


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionCases:
    """The rendezvous of one evaluation; maps are decoded on access.

    Attributes:
        pairs: of maps.
        indices: the pairs that are used.
        images: one for each of them.
    """

    pairs: PairTable
    indices: tuple[int, ...]
    images: tuple[SeenImage, ...]

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, number: int) -> FusionCase:
        return FusionCase(pair=self.pairs[self.indices[number]], image=self.images[number])

    @property
    def overlap(self) -> Array:
        """(N,) overlap of the maps."""
        chosen: Array = self.pairs.overlap[list(self.indices)]
        return chosen


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionSetup:
    """The runs of every rendezvous; can be pickled.

    Attributes:
        source: of the relative pose.
        methods: of `METHODS`.
        matcher: with weights, or None if no method needs it.
    """

    source: PoseSource
    methods: tuple[str, ...] = METHODS
    matcher: Method | None = field(default=None)

    def refiners(self) -> dict[str, Refiner | None]:
        """By method."""
        every: dict[str, Refiner | None] = {
            NONE: None,
            "hough": _hough,
            "orb": _orb,
            "correlative": correlative_refiner,
        }
        if self.matcher is not None:
            matcher = _matcher(self.matcher)
            every |= {name: matcher_refiner(matcher, with_prior=name == "auto") for name in LEARNED}
        return {name: refiner for name, refiner in every.items() if name in self.methods}


def measured_fusions(
    setup: FusionSetup,
    cases: FusionCases,
    *,
    folder: Path,
    workers: int,
    console: Console,
) -> tuple[RendezvousOutcome, ...]:
    """The outcome of each rendezvous, from the cache if nothing it depends on has changed.

    Args:
        setup: the runs.
        cases: at least one.
        folder: the report's.
        workers: processes; with a single one, this one.
        console: for messages.
    """
    measurement = Measurement(
        command="evaluate-fusion",
        name="rendezvous",
        items_name="pairs",
        measure=partial(_measure, setup),
        from_json=RendezvousOutcome.from_json,
        key=_key(setup, cases),
    )
    cache_folder = Disk(str(folder / CACHE))
    return measured(measurement, cases, cache=cache_folder, workers=workers, console=console)


def run_case(setup: FusionSetup, case: FusionCase) -> RendezvousOutcome:
    """All runs of one rendezvous."""
    estimator = setup.source.estimator(floor=True)
    image = case.image
    assert image.truth.T_r0_r1 is not None
    pose = estimator(image.pixels(), image.camera, image.T_r0_c)
    return run_rendezvous(case.pair, image.truth.T_r0_r1, pose, setup.refiners())


def _measure(setup: FusionSetup, cases: Sequence[FusionCase]) -> list[RendezvousOutcome]:
    # Once untimed: compiled code is loaded at the first call.
    run_case(setup, cases[0])
    return [run_case(setup, case) for case in cases]


def _key(setup: FusionSetup, cases: FusionCases) -> Mapping[str, Any]:
    return {
        "weights": setup.source.digest,
        "matcher": setup.matcher.weights_digest() if setup.matcher else "",
        "methods": list(setup.methods),
        "images": digest_of_images(cases.images),
        "maps": cases.pairs.digest(),
        "code": code_digest(_ROOMS, _FILES),
        "packages": versions(POSE_PACKAGES),
    }


def _hough(prior: FrameErrorPrior | None) -> tuple[HoughSpectrum, SearchRange]:
    """Searches the whole default range, without a prior."""
    return HoughSpectrum(search=DEFAULT_SEARCH), DEFAULT_SEARCH


def _orb(prior: FrameErrorPrior | None) -> tuple[OrbRansac, SearchRange]:
    """Searches wherever features match."""
    return OrbRansac(), DEFAULT_SEARCH


@cache
def _matcher(method: Method) -> Any:
    return trained(method, threads=1).estimator
