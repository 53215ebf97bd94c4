"""Bounds of the work that a floor plan makes: its repair and its erosion grow with more than its vertices.

An outline of 200 random points crosses itself some thousand times, and undoing that takes minutes; so does
eroding thousands of teeth that are thinner than a robot. No plan of a building comes near these bounds.
"""

from __future__ import annotations

import numpy as np
import shapely

from rendezvous.errors import FloorplanError
from rendezvous.floorplan.records import Floorplan

MOST_VERTICES, MOST_HOLES, MOST_ROOMS = 8_000, 500, 2_000
MOST_CROSSINGS = 500
MOST_CLOSE_WALLS = 50_000
"""Pairs of walls whose boxes, grown by half an opening, overlap; HouseExpo's plans have some thousand."""

_QUERIED = 64  # walls at a time, so that a search ends soon after it found too many


def check_work(floorplan: Floorplan) -> None:
    """Check the numbers of vertices, holes and rooms.

    Raises:
        FloorplanError: there are too many.
    """
    vertices = len(floorplan.outline_m) + sum(map(len, floorplan.holes_m))
    for found, most, what in (
        (vertices, MOST_VERTICES, "vertices"),
        (len(floorplan.holes_m), MOST_HOLES, "holes"),
        (len(floorplan.rooms), MOST_ROOMS, "rooms"),
    ):
        if found > most:
            raise FloorplanError(f"{floorplan.plan_id}: {found:,} {what}; a floor plan has at most {most:,}")


def check_crossings(floorplan: Floorplan) -> None:
    """Check how often the rings cross or touch themselves and each other.

    Raises:
        FloorplanError: more often than a repair makes sense.
    """
    edges_m = floorplan.edges_m()
    walls = shapely.linestrings(np.stack([edges_m[:, :2], edges_m[:, 2:]], axis=1))
    # Each wall meets itself and its two neighbours; a pair is found from both sides.
    most = 3 * len(walls) + 2 * MOST_CROSSINGS
    if _pairs(walls, most, predicate="intersects") > most:
        raise FloorplanError(
            f"{floorplan.plan_id}: the outline crosses itself more than {MOST_CROSSINGS:,} times; an outline "
            "must be a simple polygon"
        )


def check_close_walls(floorplan: Floorplan, grown_m: float) -> None:
    """Check how many walls lie so close to each other that eroding by `grown_m` entangles them.

    Raises:
        FloorplanError: more than in any building.
    """
    edges_m = floorplan.edges_m()
    x_m, y_m = edges_m[:, ::2], edges_m[:, 1::2]
    boxes = shapely.box(
        x_m.min(axis=1) - grown_m, y_m.min(axis=1) - grown_m,
        x_m.max(axis=1) + grown_m, y_m.max(axis=1) + grown_m,
    )  # fmt: skip
    most = len(boxes) + 2 * MOST_CLOSE_WALLS
    if _pairs(boxes, most, predicate=None) > most:
        raise FloorplanError(
            f"{floorplan.plan_id}: more than {MOST_CLOSE_WALLS:,} pairs of walls within {2 * grown_m:g} m of "
            "each other; leave out what is smaller than a robot"
        )


def _pairs(shapes: np.ndarray, most: int, *, predicate: str | None) -> int:
    """The number of ordered pairs that meet, with themselves; the count ends above `most`."""
    tree, found = shapely.STRtree(shapes), 0
    for start in range(0, len(shapes), _QUERIED):
        found += tree.query(shapes[start : start + _QUERIED], predicate=predicate).shape[1]
        if found > most:
            break
    return found
