"""How well two maps agree, and whether to trust a fused map; if not, why."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rendezvous.alignment.estimate import WRONG_M, WRONG_RAD
from rendezvous.alignment.evidence import APART_M, COINCIDE_M
from rendezvous.fusion.fusion_input import FusionInput, SightedPose
from rendezvous.fusion.refinement import FrameErrorPrior, RefinedAlignment
from rendezvous.geometry.occupancy_grid import FREE, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.geometry.wall_agreement import count_near, nearest_m


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
    """How the walls of both maps agree where the other map is known.

    A wall is as long as its cells are wide together, so that maps in cells of any size compare alike.
    """

    compared_m: float  # length of the walls in the other map's known area [m]
    # Share of it that coincides with a wall of the other map, and that lies on its floor away from its walls;
    # None where there is none.
    wall_share: float | None
    conflict_share: float | None


def map_agreement(
    grid_0: OccupancyGrid, grid_1: OccupancyGrid, T_m0_m1: SE2, *, coincide_m: float = COINCIDE_M
) -> MapAgreement:
    """Compare the walls of two maps, each with the other, with map 1 placed by `T_m0_m1`.

    Walls coincide within `coincide_m` and contradict the other map's floor beyond 0.15 m, or 0.75 and 1.25 of
    the wider cells' sides, where centres can lie no closer.
    """
    cell_m = max(grid_0.resolution_m, grid_1.resolution_m)
    limits_m = max(coincide_m, 0.75 * cell_m), max(APART_M, 1.25 * cell_m)
    lengths_m = _walls_m(grid_0, grid_1, T_m0_m1.inverse(), limits_m) + _walls_m(
        grid_1, grid_0, T_m0_m1, limits_m
    )
    compared_m, same_m, contradicting_m = lengths_m.tolist()
    return MapAgreement(
        compared_m=compared_m,
        wall_share=same_m / compared_m if compared_m else None,
        conflict_share=contradicting_m / compared_m if compared_m else None,
    )


def _walls_m(
    grid_a: OccupancyGrid, grid_b: OccupancyGrid, T_b_a: SE2, limits_m: tuple[float, float]
) -> Array:
    """(3,) [m] of a's walls: where b is known; of these, on b's walls; on b's floor away from them."""
    coincide_m, apart_m = limits_m
    walls_b = T_b_a @ grid_a.cell_centres(grid_a.occupied())
    cells = grid_b.sample(walls_b)
    walls_b, cells = walls_b[cells != UNKNOWN], cells[cells != UNKNOWN]
    away_m = nearest_m(walls_b, grid_b.cell_centres(grid_b.occupied()), within_m=apart_m)
    counts = len(cells), (away_m <= coincide_m + 1e-9).sum(), (np.isinf(away_m) & (cells == FREE)).sum()
    return grid_a.resolution_m * np.array(counts, np.float64)


AROUND_ROBOT_M = 1.5
"""A map knows something this close to its robot. Its own floor it need not know: a lidar that looks ahead has
seen it once or never where scans are far apart."""
LEAST_SCORE = 0.5  # a detection below is likelier something else: scores are calibrated probabilities
LEAST_BEST_MASS = 0.9  # needed of a sighting's best mode without refinement: a wrong one spoils the map
VERDICT_SIGMAS = 2.0
"""One error in twenty exceeds two standard deviations; an error of that size must not make the estimate
wrong."""
SURPRISING = 0.999
"""An estimate this improbable by the sighting means that one of them is wrong: by chance it happens once
in a thousand."""
LEAST_COMPARED_M = 3.0
"""Less wall of both maps together proves nothing: on recorded pairs right alignments share 5.7 m and more in
99 of 100, and half of the wrong ones less than 3.2 m."""
LEAST_WALL_SHARE, MOST_CONFLICTS = 0.5, 0.3
"""Share of these walls that coincide, and that lie on the other map's floor: right alignments of recorded and
of changed scenes have at most 0.28 of the second in 99 of 100."""
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
    if agreement.compared_m < LEAST_COMPARED_M:
        doubts.append(
            f"the maps share too little to check the alignment: {agreement.compared_m:.1f} m of walls"
        )
        return doubts
    if agreement.wall_share is not None and agreement.wall_share < LEAST_WALL_SHARE:
        doubts.append(f"only {agreement.wall_share:.0%} of the walls that both maps show coincide")
    if agreement.conflict_share is not None and agreement.conflict_share > MOST_CONFLICTS:
        doubts.append(f"{agreement.conflict_share:.0%} of the walls lie on the other map's floor")
    return doubts


def spread_of(covariance: Array) -> tuple[float, float]:
    """Standard deviations of position, along its longer axis [m], and of heading [rad]."""
    position_m = math.sqrt(float(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    return position_m, math.sqrt(float(covariance[2, 2]))
