"""The whole system on a test rendezvous: image and maps in, a fused map out, by every way to refine T̃."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rendezvous.alignment.frame_error import frame_error
from rendezvous.errors import MapError
from rendezvous.fusion.agreement import agreement
from rendezvous.fusion.fusion_input import FusionInput
from rendezvous.fusion.merge import merged
from rendezvous.fusion.refinement import Refiner
from rendezvous.fusion.sighted_pose import SightedPose, sighted_pose
from rendezvous.fusion.system import FusionResult, fuse_maps
from rendezvous.geometry.occupancy_grid import OccupancyGrid
from rendezvous.geometry.se2 import SE2
from rendezvous.pose_estimation.pose_estimate import RelativePose
from rendezvous.training.frame_error.pairs import MapPair

ESTIMATED, TRUE = "estimated", "true"
SOURCES = (ESTIMATED, TRUE)
"""Of the relative pose: read from the image, or the true one."""

NONE, AUTO = "none", "auto"
METHODS = (NONE, "hough", "orb", "correlative", "learned", AUTO)
"""How T̃ is refined, in the order of tables."""

NEEDS_COVARIANCE = (AUTO,)
"""Methods that differ from others only by what the pose's covariance tells; the true pose has none."""

Run = tuple[str, str]
"""Where the relative pose is from, and how it is refined."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionOutcome:
    """What became of one rendezvous.

    Attributes:
        T_m0_m1: T̂; None if the robot was not found in the image.
        error: the frame error that T̂ has left, seen from where T̃ puts robot 1: the components of `θ̂⁻¹ θ`.
        iou: agreement of the fused map with the true one: occupied cells that have a partner within a cell,
            over all; None without a fused map.
        accepted: the system's verdict.
        reasons: why it is not accepted; of a fusion that was not made, why not.
        refined: whether the maps gave an estimate; else T̂ is T̃.
        duration_s: from the relative pose to the fused map and the verdict.
    """

    T_m0_m1: SE2 | None
    error: SE2 | None
    iou: float | None
    accepted: bool
    reasons: tuple[str, ...]
    refined: bool
    duration_s: float

    def to_json(self) -> dict[str, Any]:
        """Values as JSON holds them."""
        return {
            "T_m0_m1": self.T_m0_m1 and self.T_m0_m1.as_array().tolist(),
            "error": self.error and self.error.as_array().tolist(),
            "iou": self.iou,
            "accepted": self.accepted,
            "reasons": list(self.reasons),
            "refined": self.refined,
            "duration_s": self.duration_s,
        }

    @staticmethod
    def from_json(fields: Mapping[str, Any]) -> FusionOutcome:
        """Inverse of `to_json`."""
        poses = {
            name: None if fields[name] is None else SE2.from_array(fields[name])
            for name in ("T_m0_m1", "error")
        }
        return FusionOutcome(**{**fields, **poses, "reasons": tuple(fields["reasons"])})


@dataclass(frozen=True, slots=True, kw_only=True)
class RendezvousOutcome:
    """What became of one rendezvous in every run.

    Attributes:
        pair_id: of the pair of maps.
        runs: outcomes by run.
    """

    pair_id: str
    runs: Mapping[Run, FusionOutcome]

    def to_json(self) -> dict[str, Any]:
        """Values as JSON holds them."""
        runs = [[*run, outcome.to_json()] for run, outcome in self.runs.items()]
        return {"pair_id": self.pair_id, "runs": runs}

    @staticmethod
    def from_json(fields: Mapping[str, Any]) -> RendezvousOutcome:
        """Inverse of `to_json`."""
        runs = {(source, method): FusionOutcome.from_json(told) for source, method, told in fields["runs"]}
        return RendezvousOutcome(pair_id=fields["pair_id"], runs=runs)


def runs_of(methods: tuple[str, ...]) -> tuple[Run, ...]:
    """All runs of some methods, in the order of tables."""
    return tuple(
        (source, method)
        for source in SOURCES
        for method in METHODS
        if method in methods and not (source == TRUE and method in NEEDS_COVARIANCE)
    )


def run_rendezvous(
    pair: MapPair, T_r0_r1_true: SE2, pose: RelativePose, refiners: Mapping[str, Refiner | None]
) -> RendezvousOutcome:
    """Every run of one rendezvous.

    Args:
        pair: maps, poses and the true transform.
        T_r0_r1_true: the true relative pose.
        pose: that was read from the image.
        refiners: by method.
    """
    true_map = merged(pair.grid_0, pair.grid_1, pair.T_m0_m1)
    assert pair.T_m0_r0 is not None
    meeting = FusionInput(grid_0=pair.grid_0, grid_1=pair.grid_1, T_m0_r0=pair.T_m0_r0, T_m1_r1=pair.T_m1_r1)
    sightings = {
        ESTIMATED: sighted_pose([pose]) if pose.found else None,
        TRUE: SightedPose.given(T_r0_r1_true),
    }
    return RendezvousOutcome(
        pair_id=pair.pair_id,
        runs={
            (source, method): _run(meeting, sighting, refiners[method], pair.T_m0_m1, true_map)
            if (sighting := sightings[source])
            else _not_made(pose.reason)
            for source, method in runs_of(tuple(refiners))
        },
    )


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
        return _not_made(str(error))
    duration_s = time.perf_counter() - started_s
    return FusionOutcome(
        T_m0_m1=result.T_m0_m1,
        error=frame_error(result.T_m0_m1, T_m0_m1_true, result.T_m0_v),
        iou=agreement(result.grid, true_map, true_map.resolution_m).iou,
        accepted=result.verdict.accepted,
        reasons=result.verdict.reasons,
        refined=_refined(result),
        duration_s=duration_s,
    )


def _refined(result: FusionResult) -> bool:
    return result.estimate is not None and result.estimate.theta is not None


def _not_made(reason: str) -> FusionOutcome:
    return FusionOutcome(
        T_m0_m1=None,
        error=None,
        iou=None,
        accepted=False,
        reasons=(reason,),
        refined=False,
        duration_s=0.0,
    )
