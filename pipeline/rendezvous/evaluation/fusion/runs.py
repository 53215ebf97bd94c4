"""The whole system on a test rendezvous: image and maps in, a fused map out, by every way to refine T̃."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

from rendezvous.alignment.frame_error import frame_error
from rendezvous.errors import MapError
from rendezvous.evaluation.json_record import JsonRecord, OptionalPose
from rendezvous.fusion.fusion_input import FusionInput, SightedPose, sighted_pose
from rendezvous.fusion.merge import merged
from rendezvous.fusion.refinement import Refiner
from rendezvous.fusion.system import fuse_maps
from rendezvous.fusion.verdict import agreement
from rendezvous.geometry.occupancy_grid import OccupancyGrid
from rendezvous.geometry.se2 import SE2
from rendezvous.methods import REFINEMENTS
from rendezvous.pose_estimation.pose_estimate import RelativePose
from rendezvous.training.frame_error.pairs import MapPair

ESTIMATED, TRUE = "estimated", "true"
SOURCES = (ESTIMATED, TRUE)
"""Sources of the relative pose: read from the image, or the true one."""

NONE, AUTO = "none", "auto"
METHODS = tuple(REFINEMENTS)
"""Ways to refine T̃, in the order of tables."""

FusionRun = tuple[str, str]
"""A source of the relative pose, and a way to refine T̃."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionOutcome(JsonRecord):
    """The fused map of one rendezvous; by default there is none."""

    T_m0_m1: OptionalPose = None  # T̂, or None if the robot was not found in the image
    # The frame error left in T̂, seen from where T̃ puts robot 1: the components of `θ̂⁻¹ θ`.
    error: OptionalPose = None
    # Agreement of the fused map with the true one, as intersection over union: occupied cells with a partner
    # within a cell, over all; None without a fused map.
    iou: float | None = None
    accepted: bool = False  # the system's verdict
    reasons: tuple[str, ...]  # why the map is not accepted, or why there is none
    refined: bool = False  # whether the maps gave an estimate; otherwise T̂ is T̃
    duration_s: float = 0.0  # from the relative pose to the fused map and the verdict


@dataclass(frozen=True, slots=True, kw_only=True)
class RendezvousOutcome(JsonRecord):
    """The fused maps of one rendezvous."""

    pair_id: str
    runs: tuple[tuple[str, str, FusionOutcome], ...]  # source, method and outcome of every run

    def __getitem__(self, run: FusionRun) -> FusionOutcome:
        return next(outcome for *named, outcome in self.runs if tuple(named) == run)


def run_name(run: FusionRun) -> str:
    """What files and figures call a run."""
    return "-".join(run)


def runs_of(methods: tuple[str, ...]) -> tuple[FusionRun, ...]:
    """All runs of some methods, in the order of tables."""
    return tuple(
        (source, method)
        for source in SOURCES
        for method in METHODS
        if method in methods and not (source == TRUE and REFINEMENTS[method].needs_covariance)
    )


def run_rendezvous(
    pair: MapPair, T_r0_r1_true: SE2, pose: RelativePose, refiners: Mapping[str, Refiner | None]
) -> RendezvousOutcome:
    """All runs of one rendezvous.

    Args:
        pair: maps, poses and the true transform.
        T_r0_r1_true: the true relative pose.
        pose: as estimated from the image.
        refiners: by method.
    """
    true_map = merged(pair.grid_0, pair.grid_1, pair.T_m0_m1)
    assert pair.T_m0_r0 is not None
    meeting = FusionInput(grid_0=pair.grid_0, grid_1=pair.grid_1, T_m0_r0=pair.T_m0_r0, T_m1_r1=pair.T_m1_r1)
    sightings = {
        ESTIMATED: sighted_pose([pose]) if pose.found else None,
        TRUE: SightedPose.given(T_r0_r1_true),
    }
    runs = []
    for source, method in runs_of(tuple(refiners)):
        sighting = sightings[source]
        if sighting is None:
            outcome = FusionOutcome(reasons=(pose.reason,))
        else:
            outcome = _run(meeting, sighting, refiners[method], pair.T_m0_m1, true_map)
        runs.append((source, method, outcome))
    return RendezvousOutcome(pair_id=pair.pair_id, runs=tuple(runs))


def _run(
    meeting: FusionInput,
    sighting: SightedPose,
    refiner: Refiner | None,
    T_m0_m1_true: SE2,
    true_map: OccupancyGrid,
) -> FusionOutcome:
    started_s = time.perf_counter()
    try:
        result = fuse_maps(meeting, sighting, refiner)
    except MapError as error:
        return FusionOutcome(reasons=(str(error),))
    duration_s = time.perf_counter() - started_s
    return FusionOutcome(
        T_m0_m1=result.T_m0_m1,
        error=frame_error(result.T_m0_m1, T_m0_m1_true, result.T_m0_v),
        iou=agreement(result.grid, true_map, true_map.resolution_m).iou,
        accepted=result.verdict.accepted,
        reasons=result.verdict.reasons,
        refined=result.estimate is not None and result.estimate.theta is not None,
        duration_s=duration_s,
    )
