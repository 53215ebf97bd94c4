from __future__ import annotations

import numpy as np
import pytest
import shapely

from rendezvous.floorplan.changes import changed_furniture
from rendezvous.floorplan.furnish import arranged, furnish
from rendezvous.floorplan.records import Solid
from rendezvous.seeds import stream
from tests.floorplan.plans import RADIUS_M, generated
from tests.floorplan.test_furnish import check_connected, footprint


def before_and_after(index: int, share: float, seed: int = 0) -> tuple[tuple[Solid, ...], tuple[Solid, ...]]:
    plan = generated(index)
    rng = stream(0, "furnish", index)
    pieces = arranged(plan, rng, density=1.0, robot_radius_m=RADIUS_M)
    after = changed_furniture(
        plan, pieces, stream(seed, "changed", index), share=share, robot_radius_m=RADIUS_M
    )
    return tuple(solid for placed in pieces for solid in placed.solids()), after


def by_item(solids: tuple[Solid, ...]) -> dict[int, set[Solid]]:
    items: dict[int, set[Solid]] = {}
    for solid in solids:
        items.setdefault(solid.item, set()).add(solid)
    return items


def test_pieces_are_what_a_plan_is_furnished_with():
    plan = generated(0)
    solids = furnish(plan, stream(0, "furnish", 0), density=1.0, robot_radius_m=RADIUS_M)
    assert before_and_after(0, 0.0) == (solids, solids)


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_a_share_is_moved_removed_or_replaced_and_the_rest_stays(share: float):
    moved = removed = added = 0
    for index in range(6):
        before, after = (by_item(solids) for solids in before_and_after(index, share))
        kept = [item for item in before if after.get(item) == before[item]]
        assert len(before) - len(kept) == round(share * len(before))
        removed += len(before.keys() - after.keys())
        moved += len(before.keys() & after.keys()) - len(kept)
        added += len(after.keys() - before.keys())
    assert min(moved, removed, added) > 5
    assert removed > added


@pytest.mark.parametrize("index", range(6))
def test_a_robot_still_gets_everywhere_and_nothing_stands_in_something_else(index: int):
    plan = generated(index)
    _, after = before_and_after(index, 0.6)
    check_connected(plan, after, RADIUS_M)
    assert all(plan.free_space().buffer(1e-6).covers(footprint(solid)) for solid in after)
    hulls = [
        shapely.union_all([footprint(solid) for solid in solids]).convex_hull
        for solids in by_item(after).values()
    ]
    for i, hull in enumerate(hulls):
        for other in hulls[:i]:
            assert hull.intersection(other).area < 0.05 * min(hull.area, other.area)


def test_what_changes_is_a_function_of_its_stream():
    assert before_and_after(1, 0.5) == before_and_after(1, 0.5)
    assert before_and_after(1, 0.5, seed=1)[1] != before_and_after(1, 0.5)[1]


def test_with_all_changed_nothing_stays_where_it_was():
    before, after = before_and_after(2, 1.0)
    assert not set(before) & set(after)
    moved_m = [
        np.hypot(a.x_m - b.x_m, a.y_m - b.y_m)
        for b in before
        for a in after
        if a.item == b.item and a.half_x_m == b.half_x_m and a.half_y_m == b.half_y_m and a.z1_m == b.z1_m
    ]
    assert moved_m
    assert np.median(moved_m) > 0.3
