"""Whether to trust a fused map, and if not, why."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rendezvous.alignment.estimate import WRONG_M, WRONG_RAD, Estimate
from rendezvous.fusion.agreement import MapAgreement
from rendezvous.fusion.fusion_input import FusionInput
from rendezvous.fusion.prior import FrameErrorPrior
from rendezvous.fusion.refinement import RefinedAlignment
from rendezvous.fusion.sighted_pose import SightedPose
from rendezvous.geometry.occupancy_grid import UNKNOWN
from rendezvous.geometry.se2 import Array

AROUND_ROBOT_M = 0.25  # a map knows at least something this close to its robot: the floor that it stands on
LEAST_SCORE = 0.5
"""A detection that scores less is as likely something else: the score is calibrated as a probability."""

LEAST_BEST_MASS = 0.9
"""Without refinement, the best mode of a sighting must be this probable: a wrong one spoils the map."""

VERDICT_SIGMAS = 2.0
"""One error in twenty exceeds two standard deviations; an error of that size must not make the estimate
wrong."""

SURPRISING = 0.999
"""An estimate this improbable by the sighting means that one of them is wrong: by chance it happens once
in a thousand."""

LEAST_COMPARED = 30
"""Occupied cells (of 5 cm: 1.5 m of wall in either map) below which agreement proves nothing."""

LEAST_WALL_SHARE = 0.6
"""Correctly refined maps of validation pairs agree on more of the walls that they share: 0.77 and up."""

MOST_CONFLICTS = 0.08
"""Share of the cells known in both maps that are occupied in one and free in the other: at most 0.07 in
such correct alignments, at least 0.07 in wrong ones."""

AGREEMENT_MARGIN = 0.05  # a fall in agreement by less than this is rounding to cells


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Whether to trust a fused map.

    Attributes:
        reasons: why it is uncertain; empty if it is accepted.
    """

    reasons: tuple[str, ...] = ()

    @property
    def accepted(self) -> bool:
        """Whether there is no doubt about the map."""
        return not self.reasons

    def __str__(self) -> str:
        return "accepted" if self.accepted else f"uncertain: {'; '.join(self.reasons)}"


def pose_doubts(given: FusionInput) -> list[str]:
    """Doubts about the robots' own poses: a map must know the place where its robot stands."""
    doubts = []
    for number, (grid, T_m_r) in enumerate(((given.grid_0, given.T_m0_r0), (given.grid_1, given.T_m1_r1))):
        side_m = np.arange(-AROUND_ROBOT_M, AROUND_ROBOT_M + 1e-9, 0.05)
        around_m = np.stack(np.meshgrid(T_m_r.x_m + side_m, T_m_r.y_m + side_m), axis=-1)
        if (grid.sample(around_m) == UNKNOWN).all():
            doubts.append(
                f"robot {number} stands at x {T_m_r.x_m:.2f} m, y {T_m_r.y_m:.2f} m, where map {number} "
                "knows nothing: is the pose in the frame of that map?"
            )
    return doubts


def sighting_doubts(sighting: SightedPose, *, refined: bool) -> list[str]:
    """Doubts about a sighting by itself."""
    doubts = []
    if sighting.score is not None and sighting.score < LEAST_SCORE:
        doubts.append(f"the robot's detection scores {sighting.score:.2f}, less than {LEAST_SCORE}")
    if others := sighting.contradicted_by:
        images = ", ".join(str(number) for number in others)
        doubts.append(
            f"image {images} shows the robot elsewhere than the others do; the best reading leaves it out"
        )
    if not refined and sighting.best.mass < LEAST_BEST_MASS:
        doubts.append(
            f"the sighting can be read in {len(sighting.modes)} ways; the best has a probability of "
            f"{sighting.best.mass:.2f} and the maps were not asked"
        )
    return doubts


def refinement_doubts(
    refined: RefinedAlignment, prior: FrameErrorPrior | None, agreements: tuple[MapAgreement, MapAgreement]
) -> list[str]:
    """Doubts about an estimate of the frame error.

    Args:
        refined: the estimate.
        prior: the sighting's.
        agreements: of the maps before and after the refinement.
    """
    estimate, search = refined.estimate, refined.search
    if estimate.theta is None:
        return [f"the maps could not refine the alignment: {estimate.reason}"]
    doubts = []
    if estimate.ambiguous:
        doubts.append("the maps fit together in more than one way")
    if refined.at_edge:
        doubts.append(
            f"the best fit of the maps lies at the edge of the search (±{search.xy_m:.2f} m, "
            f"±{math.degrees(search.yaw_rad):.0f}°), so a better one may lie beyond"
        )
    if prior is not None and _contradicts(estimate, prior):
        away_m = math.hypot(estimate.theta.x_m, estimate.theta.y_m)
        away_deg = abs(math.degrees(estimate.theta.yaw_rad))
        doubts.append(
            f"the maps put robot 1 {away_m:.2f} m and {away_deg:.1f}° from where it was seen, which is more "
            "than the sighting's covariance allows"
        )
    before, after = (agreement.wall_share for agreement in agreements)
    if before is not None and after is not None and after < before - AGREEMENT_MARGIN:
        doubts.append(
            f"{after:.0%} of the shared walls coincide after the refinement, {before:.0%} did before it"
        )
    return doubts


def _contradicts(estimate: Estimate, prior: FrameErrorPrior) -> bool:
    assert estimate.theta is not None
    spread = np.zeros((3, 3)) if estimate.covariance is None else estimate.covariance
    return prior.surprise(estimate.theta, spread) > SURPRISING


def alignment_doubts(covariance: Array | None, agreement: MapAgreement) -> list[str]:
    """Doubts about the final alignment."""
    doubts = []
    if covariance is not None:
        position_m, heading_rad = spread_of(covariance)
        if VERDICT_SIGMAS * position_m > WRONG_M or VERDICT_SIGMAS * heading_rad > WRONG_RAD:
            doubts.append(
                f"the alignment is known to ±{position_m:.2f} m and ±{math.degrees(heading_rad):.1f}° only"
            )
    if agreement.wall_share is None or agreement.compared < LEAST_COMPARED:
        doubts.append(
            f"the maps share too little to check the alignment: {agreement.compared} cells of walls"
        )
        return doubts
    if agreement.wall_share < LEAST_WALL_SHARE:
        doubts.append(f"only {agreement.wall_share:.0%} of the walls that both maps show coincide")
    if agreement.conflict_share is not None and agreement.conflict_share > MOST_CONFLICTS:
        doubts.append(f"the maps contradict each other in {agreement.conflict_share:.0%} of what both know")
    return doubts


def spread_of(covariance: Array) -> tuple[float, float]:
    """Standard deviations of position, along its longer axis [m], and of heading [rad]."""
    position_m = math.sqrt(float(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    return position_m, math.sqrt(float(covariance[2, 2]))
