"""The paper's system (Fig. 2): from two maps, both robots' poses and a sighting to one global map."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass

from rendezvous.alignment.estimate import Estimate
from rendezvous.alignment.frame_error import corrected, initial_alignment, meeting_point
from rendezvous.fusion.fusion_input import FusionInput, SightedPose
from rendezvous.fusion.merge import Merging
from rendezvous.fusion.refinement import (
    FrameErrorPrior,
    RefinedAlignment,
    Refiner,
    frame_error_prior,
    refined,
)
from rendezvous.fusion.verdict import (
    MapAgreement,
    Verdict,
    alignment_doubts,
    map_agreement,
    pose_doubts,
    refinement_doubts,
    sighting_doubts,
)
from rendezvous.geometry.occupancy_grid import OccupancyGrid, overlap
from rendezvous.geometry.se2 import SE2, Array

Part = Callable[[str], AbstractContextManager[object]]  # wraps a part of the work by name, to time it


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionResult:
    """A global map, and how far to trust it.

    Attributes:
        grid: the fused map, in m0.
        T_m0_m1: T̂, the pose of map 1 in map 0 (Eq. 3); T̃ if it was not refined.
        T_m0_m1_initial: T̃, from the sighting alone (Eq. 2).
        T_m0_v: the window's centre, with the axes of m0: where T̃ puts robot 1.
        covariance: (3, 3) of the components x [m], y [m], yaw [rad] of the remaining frame error `θ̂_v⁻¹ θ_v`,
            seen from v along the axes of m0; None if unknown.
        degrees_of_freedom: of the Student's t distribution with this covariance; infinite for a normal one.
        estimate: of T̃'s frame error; None if there was no refinement.
        sighting: with all its modes.
        overlap: |known_0 ∩ known_1| / |known_0 ∪ known_1| under T̂.
        before, after: agreement of the maps under T̃ and under T̂.
        verdict: accepted, or why it is uncertain.
    """

    grid: OccupancyGrid
    T_m0_m1: SE2
    T_m0_m1_initial: SE2
    T_m0_v: SE2
    covariance: Array | None
    degrees_of_freedom: float
    estimate: Estimate | None
    sighting: SightedPose
    overlap: float
    before: MapAgreement
    after: MapAgreement
    verdict: Verdict


def fuse_maps(
    given: FusionInput,
    sighting: SightedPose,
    refiner: Refiner | None,
    *,
    merge: Merging = Merging.OCCUPIED,
    part: Part = lambda name: nullcontext(),
) -> FusionResult:
    """Fuse two maps.

    Args:
        given: maps and poses.
        sighting: where robot 0 saw robot 1.
        refiner: gives the estimator of the frame error; None leaves T̃ as it is.
        merge: how the aligned maps become one.
        part: entered around each part: `refine`, `check`, `merge`.

    Raises:
        MapError: the poses put the maps so far apart that the fused map would be unreasonably large.
    """
    T_initial = initial_alignment(given.T_m0_r0, sighting.best.T_r0_r1, given.T_m1_r1)
    T_m0_v = meeting_point(T_initial, given.T_m1_r1)
    prior = frame_error_prior(sighting, given.T_m0_r0, slam=given.slam)
    with part("refine"):
        found = refined(given, T_initial, T_m0_v, refiner, prior) if refiner else None
    theta = found.estimate.theta if found else None
    T_m0_m1 = corrected(T_initial, theta, T_m0_v) if theta else T_initial
    with part("merge"):
        grid = merge(given.grid_0, given.grid_1, T_m0_m1)
    with part("check"):
        before, after = (map_agreement(given.grid_0, given.grid_1, T) for T in (T_initial, T_m0_m1))
        covariance, degrees_of_freedom = _spread(found, prior)
        doubts = pose_doubts(given) + sighting_doubts(sighting, refined=theta is not None)
        if found:
            doubts += refinement_doubts(found, prior, (before, after))
        doubts += alignment_doubts(covariance, after)
        shared = overlap(given.grid_0, given.grid_1, T_m0_m1)
    return FusionResult(
        grid=grid,
        T_m0_m1=T_m0_m1,
        T_m0_m1_initial=T_initial,
        T_m0_v=T_m0_v,
        covariance=covariance,
        degrees_of_freedom=degrees_of_freedom,
        estimate=found.estimate if found else None,
        sighting=sighting,
        overlap=shared,
        before=before,
        after=after,
        verdict=Verdict(reasons=tuple(doubts)),
    )


def _spread(found: RefinedAlignment | None, prior: FrameErrorPrior | None) -> tuple[Array | None, float]:
    """Covariance and degrees of freedom of the remaining frame error: the maps', or else the sighting's."""
    if found and found.estimate.theta is not None:
        return found.estimate.covariance, found.estimate.degrees_of_freedom
    return (prior.modes[0].covariance, prior.degrees_of_freedom[0]) if prior else (None, math.inf)
