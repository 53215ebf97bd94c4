"""How well two maps agree, and whether to trust a fused map; if not, why."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rendezvous.alignment.estimate import WRONG_M, WRONG_RAD
from rendezvous.fusion.fusion_input import FusionInput, SightedPose
from rendezvous.fusion.refinement import FrameErrorPrior, RefinedAlignment
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.geometry.wall_agreement import count_near, wall_agreement


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """How the occupied cells of two maps in one frame coincide within a tolerance."""

    # occupied_a, occupied_b: occupied cells of each map.
    occupied_a: int
    occupied_b: int
    near_a: int  # those of a within the tolerance of an occupied cell of b
    near_b: int  # those of b within the tolerance of an occupied cell of a

    @property
    def iou(self) -> float | None:
        """Intersection over union in [0, 1]; None for two maps without occupied cells.

        A cell with a partner within the tolerance is in both maps: the intersection is
        `(near_a + near_b) / 2`, the union all cells less that. With tolerance 0 on one grid this is the
        intersection over union of the two sets of cells. Maps of different resolution count cells of
        different size; compare those by `share_a` and `share_b`.
        """
        both = 0.5 * (self.near_a + self.near_b)
        union = self.occupied_a + self.occupied_b - both
        return both / union if union else None

    @property
    def share_a(self) -> float | None:
        """near_a / occupied_a: how much of map a is in b; None for a map without occupied cells."""
        return self.near_a / self.occupied_a if self.occupied_a else None

    @property
    def share_b(self) -> float | None:
        """near_b / occupied_b: how much of map b is in a; None for a map without occupied cells."""
        return self.near_b / self.occupied_b if self.occupied_b else None


def agreement(grid_a: OccupancyGrid, grid_b: OccupancyGrid, tolerance_m: float) -> Agreement:
    """Compare the occupied cells of two maps in one frame, of any size, resolution and origin.

    Distances are between centres of cells: a tolerance of one cell's side reaches a cell's four neighbours,
    not the diagonal ones.
    """
    walls_a, walls_b = grid_a.cell_centres(grid_a.occupied()), grid_b.cell_centres(grid_b.occupied())
    return Agreement(
        occupied_a=len(walls_a),
        occupied_b=len(walls_b),
        near_a=count_near(walls_a, walls_b, tolerance_m),
        near_b=count_near(walls_b, walls_a, tolerance_m),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class MapAgreement:
    """How two maps agree where both are known; each figure counts cells of both maps."""

    # Of the occupied cells in the other map's known area, the share within the tolerance of an occupied cell
    # there; None where there are none.
    wall_share: float | None
    # Of the cells in the other map's known area, the share where one map says occupied and the other free: 1
    # minus the acceptance index of Carpin (2008). None where nothing is known in both.
    conflict_share: float | None
    compared: int  # number of cells behind `wall_share`
    known_in_both: int  # number of cells behind `conflict_share`


def map_agreement(
    grid_0: OccupancyGrid, grid_1: OccupancyGrid, T_m0_m1: SE2, *, tolerance_m: float = 0.10
) -> MapAgreement:
    """Compare two maps where both are known, with map 1 placed by `T_m0_m1`; symmetric in the maps."""
    walls = wall_agreement(grid_0, grid_1, T_m0_m1, tolerance_m=tolerance_m)
    there = _conflicts(grid_0, grid_1, T_m0_m1.inverse())
    back = _conflicts(grid_1, grid_0, T_m0_m1)
    known_in_both = there[0] + back[0]
    return MapAgreement(
        wall_share=walls.share,
        conflict_share=(there[1] + back[1]) / known_in_both if known_in_both else None,
        compared=walls.compared,
        known_in_both=known_in_both,
    )


def _conflicts(grid_a: OccupancyGrid, grid_b: OccupancyGrid, T_b_a: SE2) -> tuple[int, int]:
    """Number of a's cells that are known in both maps, and of those on which the maps contradict each
    other."""
    known_a = grid_a.known()
    values_a = grid_a.cells[known_a]
    values_b = grid_b.sample(T_b_a @ grid_a.cell_centres(known_a))
    conflict = ((values_a == OCCUPIED) & (values_b == FREE)) | ((values_a == FREE) & (values_b == OCCUPIED))
    return int((values_b != UNKNOWN).sum()), int(conflict.sum())


AROUND_ROBOT_M = 0.25  # a map knows at least something this close to its robot: the floor that it stands on
LEAST_SCORE = 0.5  # a detection below is likelier something else: scores are calibrated probabilities
LEAST_BEST_MASS = 0.9  # needed of a sighting's best mode without refinement: a wrong one spoils the map
VERDICT_SIGMAS = 2.0
"""One error in twenty exceeds two standard deviations; an error of that size must not make the estimate
wrong."""
SURPRISING = 0.999
"""An estimate this improbable by the sighting means that one of them is wrong: by chance it happens once
in a thousand."""
LEAST_COMPARED = 30  # fewer occupied cells (of 5 cm: 1.5 m of wall in either map) prove nothing
LEAST_WALL_SHARE = 0.6
"""Correctly refined maps of validation pairs agree on more of the walls that they share: 0.77 and up."""
MOST_CONFLICTS = 0.08
"""Share of the cells known in both maps that are occupied in one and free in the other: at most 0.07 in
such correct alignments, at least 0.07 in wrong ones."""
AGREEMENT_MARGIN = 0.05  # a fall in agreement by less than this is rounding to cells


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Whether to trust a fused map."""

    reasons: tuple[str, ...] = ()  # why it is uncertain; empty if it is accepted

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
    """Doubts about an estimate of the frame error."""
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
    spread = np.zeros((3, 3)) if estimate.covariance is None else estimate.covariance
    if prior is not None and prior.surprise(estimate.theta, spread) > SURPRISING:
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
