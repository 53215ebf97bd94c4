"""Make the maps of a pair look like those of real robots.

Simulated maps are clean. Real ones are built from few scans, so that rays leave streaks and wedges; beams
pass through doors and windows far into the unknown; walls are ragged, thick or missing; furniture stands in
one map and was gone before the other; each map is bent a little by its SLAM, and has a resolution of its own.
Defects are drawn for each map separately, except furniture and cuts, which concern both. The label stays.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import compress
from typing import NamedTuple

import cv2
import numpy as np

from rendezvous.errors import ConfigError, require_within
from rendezvous.geometry.occupancy_grid import OCCUPIED, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.training.frame_error.defects import (
    bent,
    beyond_line_unknown,
    free_cells,
    patched,
    ragged,
    rescanned,
    specked,
    thickened,
    with_spurious_rays,
)
from rendezvous.training.frame_error.pairs import MapPair

_IN_BOTH = 0.7  # share of obstacles that stand in both maps; the others were moved between the two visits

_ROBOT_RADIUS_M = 0.15
_SUBPIXEL_BITS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Augmentation:
    """How often each defect affects a pair (furniture, cut) or a map (all others), and how strong it can
    be.
    """

    untouched: float = 0.15  # share of pairs that stay as they are; the shares below are of the others
    furniture: float = 0.4  # obstacles appear in both maps, some in one only
    furniture_things: int = 12  # largest number of them
    cut: float = 0.3  # map 0 ends at a line, map 1 at a parallel one, so that little overlap is left
    cut_overlap_m: tuple[float, float] = (1.0, 6.0)  # least and greatest width of the strip that both keep
    bend: float = 0.5  # the map is bent by smooth waves
    bend_m: float = 0.03  # their greatest amplitude
    resolution: float = 0.3  # the map is redrawn in cells of another size
    resolution_m: tuple[float, float] = (0.03, 0.1)  # least and greatest size
    rescan: float = 0.4  # the map is built again from the rays of few scans
    spurious: float = 0.3  # fans of rays pass through walls
    thick: float = 0.2  # walls grow by one cell to all sides
    ragged: float = 0.5  # wall cells are missing, others grown
    patches: float = 0.3  # patches and wedges become unknown
    specks: float = 0.3  # single cells amid the free become unknown or occupied

    def __post_init__(self) -> None:
        shares = ("untouched", "furniture", "cut", "bend", "resolution", "rescan", "spurious", "thick")
        require_within(self, **dict.fromkeys((*shares, "ragged", "patches", "specks"), (0.0, 1.0)))
        require_within(self, furniture_things=(1, 100), bend_m=(0.0, 0.1))
        for name, least, most in (("cut_overlap_m", 0.0, 100.0), ("resolution_m", 0.01, 1.0)):
            low, high = getattr(self, name)
            if not least <= low <= high <= most:
                raise ConfigError(
                    f"Augmentation: {name} is {[low, high]}; must rise from at least {least:g} to at most "
                    f"{most:g}"
                )


def augmented(pair: MapPair, parameters: Augmentation, rng: np.random.Generator) -> MapPair:
    """The pair with defects drawn for it."""
    if rng.random() < parameters.untouched:
        return pair
    grids = [pair.grid_0, pair.grid_1]
    T_m_m0 = (SE2.identity(), pair.T_m0_m1.inverse())
    if rng.random() < parameters.furniture:
        obstacles = draw_obstacles(pair, count=int(rng.integers(1, parameters.furniture_things + 1)), rng=rng)
        seen = [tuple(compress(obstacles.obstacles, of_robot)) for of_robot in obstacles.shown.T]
        grids = [with_obstacles(grid, seen[i], T_m_m0[i]) for i, grid in enumerate(grids)]
    meeting = (pair.T_m0_r1, pair.T_m1_r1)
    grids = [
        _with_defects(grid, T_m_r1, parameters, rng) for grid, T_m_r1 in zip(grids, meeting, strict=True)
    ]
    if rng.random() < parameters.cut:
        grids = _cut(pair, grids, parameters, rng)
    return replace(pair, grid_0=grids[0], grid_1=grids[1])


def _with_defects(
    grid: OccupancyGrid, T_m_r1: SE2, parameters: Augmentation, rng: np.random.Generator
) -> OccupancyGrid:
    """One map with its own defects, in the order in which they arise on a robot."""
    bend_m = parameters.bend_m if rng.random() < parameters.bend else 0.0
    coarser = rng.random() < parameters.resolution
    cell_m = float(rng.uniform(*parameters.resolution_m)) if coarser else grid.resolution_m
    if bend_m or coarser:
        grid = bent(grid, T_m_r1, amplitude_m=bend_m, resolution_m=cell_m, rng=rng)
    if rng.random() < parameters.rescan:
        grid = rescanned(grid, rng)
    if rng.random() < parameters.spurious:
        grid = with_spurious_rays(grid, rng)
    for share, defect in (
        (parameters.thick, thickened),
        (parameters.ragged, ragged),
        (parameters.patches, patched),
        (parameters.specks, specked),
    ):
        if rng.random() < share:
            grid = defect(grid, rng)
    return grid


def _cut(
    pair: MapPair, grids: list[OccupancyGrid], parameters: Augmentation, rng: np.random.Generator
) -> list[OccupancyGrid]:
    """Map 0 without what lies beyond a line near the meeting point, map 1 without what lies before another
    line."""
    strip_m, heading_rad = rng.uniform(*parameters.cut_overlap_m), rng.uniform(-np.pi, np.pi)
    meeting = SE2(pair.T_m0_r1.x_m, pair.T_m0_r1.y_m, float(heading_rad))
    share = rng.uniform(0.0, 1.0)
    T_m0_line = meeting @ SE2(float(share * strip_m), 0.0, 0.0)
    T_m1_line = pair.T_m0_m1.inverse() @ meeting @ SE2(float((share - 1.0) * strip_m), 0.0, np.pi)
    return [beyond_line_unknown(grids[0], T_m0_line), beyond_line_unknown(grids[1], T_m1_line)]


class Obstacle(NamedTuple):
    """Closed outlines in m0, each (N, 2) [m]; a table has four, its legs."""

    outlines_m: tuple[Array, ...]


@dataclass(frozen=True, slots=True)
class Obstacles:
    """Obstacles, and which maps show them: (N, 2) bool."""

    obstacles: tuple[Obstacle, ...]
    shown: np.ndarray[tuple[int, int], np.dtype[np.bool_]]


def draw_obstacles(pair: MapPair, *, count: int, rng: np.random.Generator) -> Obstacles:
    """At most `count` obstacles at free cells of either map, uniform; a third each boxes, round ones,
    tables.

    None stands on a robot or between the two, which see each other.
    """
    places_m0 = [
        T_m0_m @ p_m
        for grid, T_m0_m in ((pair.grid_0, SE2.identity()), (pair.grid_1, pair.T_m0_m1))
        for p_m in grid.T_m_g @ (grid.resolution_m * free_cells(grid, count, rng)[:, ::-1])
    ]
    which = rng.integers(0, len(places_m0), count) if places_m0 else ()
    drawn = [_obstacle(places_m0[int(i)], rng) for i in which]
    obstacles = [obstacle for obstacle in drawn if not _in_the_way(obstacle, pair)]
    shown = np.ones((len(obstacles), 2), np.bool_)
    moved = np.flatnonzero(rng.random(len(obstacles)) >= _IN_BOTH)
    shown[moved, rng.integers(0, 2, len(moved))] = False
    return Obstacles(obstacles=tuple(obstacles), shown=shown)


def _in_the_way(obstacle: Obstacle, pair: MapPair) -> bool:
    """Whether an obstacle is closer to the line of sight than a robot's radius."""
    seen_m = np.array([pair.T_m0_r1.x_m, pair.T_m0_r1.y_m])
    T_m0_r0 = pair.T_m0_r0 or pair.T_m0_r1
    along_m = seen_m - (T_m0_r0.x_m, T_m0_r0.y_m)
    outline_m = np.concatenate(obstacle.outlines_m)
    centre_m = outline_m.mean(axis=0)
    radius_m = float(np.hypot(*(outline_m - centre_m).T).max())
    share = np.clip((seen_m - centre_m) @ along_m / max(float(along_m @ along_m), 1e-9), 0.0, 1.0)
    away_m = float(np.hypot(*(seen_m - share * along_m - centre_m)))
    return away_m < radius_m + _ROBOT_RADIUS_M


def _obstacle(p_m0: Array, rng: np.random.Generator) -> Obstacle:
    T_m0_obstacle = SE2(float(p_m0[0]), float(p_m0[1]), float(rng.uniform(-np.pi, np.pi)))
    kind = rng.integers(3)
    if kind == 0:  # a chest, a shelf, a bed: 0.2 to 1.6 m by 0.2 to 0.8 m
        return Obstacle((T_m0_obstacle @ _box(rng.uniform(0.2, 1.6), rng.uniform(0.2, 0.8)),))
    if kind == 1:  # a bin, a column, a plant
        angles_rad = np.linspace(0.0, 2.0 * np.pi, 10, endpoint=False)
        circle = np.stack([np.cos(angles_rad), np.sin(angles_rad)], axis=1)
        return Obstacle((T_m0_obstacle @ (rng.uniform(0.08, 0.35) * circle),))
    half_m = rng.uniform(0.2, 0.7, 2) / np.array([1.0, 1.5])
    corners = half_m * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return Obstacle(tuple(T_m0_obstacle @ (corner + _box(0.05, 0.05)) for corner in corners))


def _box(length_m: float, width_m: float) -> Array:
    half = 0.5 * np.array([length_m, width_m])
    return half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def with_obstacles(grid: OccupancyGrid, obstacles: tuple[Obstacle, ...], T_m_m0: SE2) -> OccupancyGrid:
    """The map with the obstacles' outlines occupied and their inside unknown, where the map is known."""
    painted = grid.cells.copy()
    T_g_m0 = grid.T_m_g.inverse() @ T_m_m0
    for obstacle in obstacles:
        outlines = [_pixels(T_g_m0 @ outline / grid.resolution_m) for outline in obstacle.outlines_m]
        for outline in outlines:
            cv2.fillPoly(painted, [outline], UNKNOWN, cv2.LINE_8, _SUBPIXEL_BITS)
        cv2.polylines(painted, outlines, True, OCCUPIED, 1, cv2.LINE_8, _SUBPIXEL_BITS)
    return replace(grid, cells=np.where(grid.cells == UNKNOWN, np.uint8(UNKNOWN), painted))


def _pixels(col_row: Array) -> np.ndarray[tuple[int, ...], np.dtype[np.int32]]:
    """OpenCV's fixed-point pixels, whose integers are the centres of cells."""
    return np.round((col_row - 0.5) * 2**_SUBPIXEL_BITS).astype(np.int32)
