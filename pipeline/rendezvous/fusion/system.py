"""The paper's system (Fig. 2): two maps, both robots' poses and a sighting in, one global map out."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass

from rendezvous.alignment.estimate import Estimate
from rendezvous.alignment.frame_error import corrected, initial_alignment, meeting_point
from rendezvous.fusion.agreement import MapAgreement, map_agreement
from rendezvous.fusion.meeting import Meeting
from rendezvous.fusion.merge import Merging
from rendezvous.fusion.prior import FrameErrorPrior, frame_error_prior
from rendezvous.fusion.refinement import Refined, Refiner, refined
from rendezvous.fusion.sighted_pose import SightedPose
from rendezvous.fusion.verdict import (
    Verdict,
    alignment_doubts,
    pose_doubts,
    refinement_doubts,
    sighting_doubts,
)
from rendezvous.geometry.occupancy_grid import OccupancyGrid, overlap
from rendezvous.geometry.se2 import SE2, Array

Part = Callable[[str], AbstractContextManager[object]]
"""Around each part of the work, by its name; the caller may time it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionResult:
    """A global map, and how far it can be trusted.

    Attributes:
        grid: the fused map, in m0.
        T_m0_m1: T̂, the pose of map 1 in map 0 (Eq. 3); T̃ where it was not refined.
        T_m0_m1_initial: T̃, from the sighting alone (Eq. 2).
        T_m0_w: the window's centre: where T̃ puts robot 1.
        covariance: (3, 3) of the components x [m], y [m], yaw [rad] of the frame error that T̂ has left,
            `θ̂_w⁻¹ θ_w`: seen from w, along the axes of m0. None if nothing is known of it.
        degrees_of_freedom: of the Student's t distribution that has this covariance; infinite: normal.
        estimate: of the frame error of T̃; None if it was not looked for.
        sighting: all ways to read it.
        overlap: |known_0 ∩ known_1| / |known_0 ∪ known_1| under T̂.
        before, after: agreement of the maps under T̃ and under T̂.
        verdict: accepted, or why it is uncertain.
    """

    grid: OccupancyGrid
    T_m0_m1: SE2
    T_m0_m1_initial: SE2
    T_m0_w: SE2
    covariance: Array | None
    degrees_of_freedom: float
    estimate: Estimate | None
    sighting: SightedPose
    overlap: float
    before: MapAgreement
    after: MapAgreement
    verdict: Verdict


def fuse_maps(
    meeting: Meeting,
    sighting: SightedPose,
    refiner: Refiner | None,
    *,
    merge: Merging = Merging.OCCUPIED,
    part: Part = lambda name: nullcontext(),
) -> FusionResult:
    """The global map of a meeting.

    Args:
        meeting: maps and poses.
        sighting: where robot 0 saw robot 1.
        refiner: gives the estimator of the frame error; None leaves T̃ as it is.
        merge: how the aligned maps become one.
        part: entered around each part: `refine`, `check`, `merge`.

    Raises:
        MapError: the poses put the maps so far apart that the fused map would be unreasonably large.
    """
    T_initial = initial_alignment(meeting.T_m0_r0, sighting.best.T_r0_r1, meeting.T_m1_r1)
    T_m0_w = meeting_point(T_initial, meeting.T_m1_r1)
    prior = frame_error_prior(sighting, meeting.T_m0_r0, slam=meeting.slam)
    with part("refine"):
        found = refined(meeting, T_initial, T_m0_w, refiner, prior) if refiner else None
    theta = found.estimate.theta if found else None
    T_m0_m1 = corrected(T_initial, theta, T_m0_w) if theta else T_initial
    with part("merge"):
        grid = merge(meeting.grid_0, meeting.grid_1, T_m0_m1)
    with part("check"):
        before, after = (map_agreement(meeting.grid_0, meeting.grid_1, T) for T in (T_initial, T_m0_m1))
        covariance, tails = _spread(found, prior)
        doubts = pose_doubts(meeting) + sighting_doubts(sighting, refined=theta is not None)
        if found:
            doubts += refinement_doubts(found, prior, (before, after))
        doubts += alignment_doubts(covariance, after)
        shared = overlap(meeting.grid_0, meeting.grid_1, T_m0_m1)
    return FusionResult(
        grid=grid,
        T_m0_m1=T_m0_m1,
        T_m0_m1_initial=T_initial,
        T_m0_w=T_m0_w,
        covariance=covariance,
        degrees_of_freedom=tails,
        estimate=found.estimate if found else None,
        sighting=sighting,
        overlap=shared,
        before=before,
        after=after,
        verdict=Verdict(reasons=tuple(doubts)),
    )


def _spread(found: Refined | None, prior: FrameErrorPrior | None) -> tuple[Array | None, float]:
    """Covariance and degrees of freedom of what is left of the frame error: the maps', or the sighting's
    where they told nothing."""
    if found and found.estimate.theta is not None:
        return found.estimate.covariance, found.estimate.degrees_of_freedom
    return (prior.modes[0].covariance, prior.degrees_of_freedom[0]) if prior else (None, math.inf)
