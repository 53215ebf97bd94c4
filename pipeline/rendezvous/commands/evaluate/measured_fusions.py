"""Measure what the whole system makes of rendezvous: image and maps in, fused maps out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

from rendezvous.commands.evaluate.measuring import EvaluationSettings, Measurement, measured
from rendezvous.evaluation.fusion.runs import RendezvousOutcome, run_rendezvous
from rendezvous.fusion.refinement import Refiner, matcher_refiner
from rendezvous.geometry.se2 import Array
from rendezvous.methods import REFINEMENTS
from rendezvous.stages.training.seen_images import SeenImage, digest_of_images
from rendezvous.stages.weights.estimators import SelectedMethod, trained
from rendezvous.stages.weights.pose_source import PoseSource
from rendezvous.training.frame_error.pairs import MapPair, PairTable


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionCase:
    """A rendezvous: its pair of maps, and what robot 0 saw."""

    pair: MapPair
    image: SeenImage


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionCases:
    """The rendezvous of one evaluation; maps are decoded on access."""

    pairs: PairTable  # of maps
    indices: tuple[int, ...]  # the pairs that are used
    images: tuple[SeenImage, ...]  # one for each of them

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
    """The runs of every rendezvous; can be pickled."""

    source: PoseSource  # of the relative pose
    methods: tuple[str, ...] = tuple(REFINEMENTS)  # of `REFINEMENTS`
    matcher: SelectedMethod | None = None  # with weights; None where no method needs it

    def refiners(self) -> dict[str, Refiner | None]:
        """The refiner of each method that can run."""
        matcher: Any = None if self.matcher is None else _matcher(self.matcher)
        return {
            name: matcher_refiner(matcher, with_prior=way.needs_covariance)
            if way.needs_matcher
            else way.refiner
            for name, way in REFINEMENTS.items()
            if name in self.methods and not (way.needs_matcher and matcher is None)
        }


def measured_fusions(
    setup: FusionSetup, cases: FusionCases, settings: EvaluationSettings
) -> tuple[RendezvousOutcome, ...]:
    """The outcome of each rendezvous, from the cache if nothing it depends on has changed."""
    measurement = Measurement(
        command="evaluate-fusion",
        cache="fusion",
        name="rendezvous",
        items_name="pairs",
        measure=partial(_measure, setup),
        outcome=RendezvousOutcome,
        key={
            "weights": setup.source.digest,
            "matcher": setup.matcher.weights_digest() if setup.matcher else "",
            "methods": list(setup.methods),
            "images": digest_of_images(cases.images),
            "maps": cases.pairs.digest(),
        },
    )
    return measured(measurement, cases, settings)


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


@cache
def _matcher(method: SelectedMethod) -> Any:
    return trained(method, threads=1).estimator
