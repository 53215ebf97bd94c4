"""Whether a fused map is to be trusted, and if not, why."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rendezvous.alignment.estimate import WRONG_M, WRONG_RAD, Estimate
from rendezvous.fusion.agreement import MapAgreement
from rendezvous.fusion.meeting import Meeting
from rendezvous.fusion.prior import FrameErrorPrior
from rendezvous.fusion.refinement import Refined
from rendezvous.fusion.sighted_pose import SightedPose
from rendezvous.geometry.occupancy_grid import UNKNOWN
from rendezvous.geometry.se2 import Array

AROUND_ROBOT_M = 0.25
"""A map knows something so close to its robot: the floor that it stands on."""

LEAST_SCORE = 0.5
"""Detections that score less are as likely something else: the score is fitted to be a probability."""

LEAST_MASS = 0.9
"""Unrefined, the best reading of a sighting must be this probable: a wrong one spoils the map."""

SIGMAS = 2.0
"""An error of so many standard deviations, which one in twenty exceeds, must not be a wrong estimate's."""

SURPRISING = 0.999
"""An estimate this improbable by the sighting is wrong, or the sighting is: by chance one in a thousand."""

LEAST_COMPARED = 30
"""Occupied cells (of 5 cm: 1.5 m of wall in either map) below which agreement tells nothing."""

LEAST_WALL_SHARE = 0.6
"""Refined maps of validation pairs that lie right agree on more of the walls that they share: 0.77 and up."""

MOST_CONFLICTS = 0.08
"""Cells, of those known in both maps, that are occupied in one and free in the other: 0.07 at most where such
maps lie right, 0.07 at least where they lie wrong."""

AGREEMENT_MARGIN = 0.05
"""Agreement that falls by less than this in refinement has not changed: cells round."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Whether a fused map is to be trusted.

    Attributes:
        reasons: why it is uncertain; none if it is accepted.
    """

    reasons: tuple[str, ...] = ()

    @property
    def accepted(self) -> bool:
        """Whether nothing speaks against the map."""
        return not self.reasons

    def __str__(self) -> str:
        return "accepted" if self.accepted else f"uncertain: {'; '.join(self.reasons)}"


def pose_doubts(meeting: Meeting) -> list[str]:
    """What speaks against the robots' own poses: a robot's map knows the place where it stands."""
    doubts = []
    for number, (grid, T_m_r) in enumerate(
        ((meeting.grid_0, meeting.T_m0_r0), (meeting.grid_1, meeting.T_m1_r1))
    ):
        side_m = np.arange(-AROUND_ROBOT_M, AROUND_ROBOT_M + 1e-9, 0.05)
        around_m = np.stack(np.meshgrid(T_m_r.x_m + side_m, T_m_r.y_m + side_m), axis=-1)
        if (grid.sample(around_m) == UNKNOWN).all():
            doubts.append(
                f"robot {number} stands at x {T_m_r.x_m:.2f} m, y {T_m_r.y_m:.2f} m, where map {number} "
                "knows nothing: is the pose in the frame of that map?"
            )
    return doubts


def sighting_doubts(sighting: SightedPose, *, refined: bool) -> list[str]:
    """What speaks against a sighting by itself."""
    doubts = []
    if sighting.score is not None and sighting.score < LEAST_SCORE:
        doubts.append(f"the robot's detection scores {sighting.score:.2f}, less than {LEAST_SCORE}")
    if others := sighting.contradicted_by:
        images = ", ".join(str(number) for number in others)
        doubts.append(
            f"image {images} shows the robot elsewhere than the others do; the best reading leaves it out"
        )
    if not refined and sighting.best.mass < LEAST_MASS:
        doubts.append(
            f"the sighting can be read in {len(sighting.modes)} ways; the best has a probability of "
            f"{sighting.best.mass:.2f} and the maps were not asked"
        )
    return doubts


def refinement_doubts(
    refined: Refined, prior: FrameErrorPrior | None, agreements: tuple[MapAgreement, MapAgreement]
) -> list[str]:
    """What speaks against an estimate of the frame error.

    Args:
        refined: what the method found.
        prior: what the sighting says.
        agreements: of the maps before and after.
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
    """What speaks against the final alignment."""
    doubts = []
    if covariance is not None:
        position_m, heading_rad = spread_of(covariance)
        if SIGMAS * position_m > WRONG_M or SIGMAS * heading_rad > WRONG_RAD:
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
