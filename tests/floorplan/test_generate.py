from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import shapely

from rendezvous.errors import FloorplanError
from rendezvous.floorplan.furnish import furnish
from rendezvous.floorplan.generate import GeneratorParameters, generate_floorplan, shipped_floorplans
from rendezvous.floorplan.houseexpo import houseexpo_json, parse_floorplan
from rendezvous.floorplan.records import Floorplan
from rendezvous.floorplan.validate import reachable_space, start_regions, validated
from rendezvous.seeds import stream
from tests.floorplan.plans import RADIUS_M

SHIPPED = Path(__file__).parents[2] / "floorplans"
KINDS = {
    "apartment": GeneratorParameters(apartment=1.0, office=0.0, hall=0.0),
    "office": GeneratorParameters(apartment=0.0, office=1.0, hall=0.0),
    "hall": GeneratorParameters(apartment=0.0, office=0.0, hall=1.0),
    "large_hall": GeneratorParameters(apartment=0.0, office=0.0, hall=0.0, large_hall=1.0),
    "warehouse": GeneratorParameters(apartment=0.0, office=0.0, hall=0.0, warehouse=1.0),
}


@cache
def plans_of(kind: str, count: int) -> list[Floorplan]:
    return [
        generate_floorplan(
            stream(1, kind, i), plan_id=f"{kind}-{i}", parameters=KINDS[kind], robot_radius_m=RADIUS_M
        )
        for i in range(count)
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_generated_plans_are_valid_and_all_rooms_are_reached(kind: str):
    plans = plans_of(kind, 24)
    for plan in plans:
        assert validated(plan, robot_radius_m=RADIUS_M).digest() == plan.digest()
        assert 3 <= len(plan.rooms) <= 20
        reached = reachable_space(plan, robot_radius_m=0.135).buffer(0.15)
        for room in plan.rooms:
            free = plan.free_space().intersection(shapely.box(*room.box_m))
            assert reached.intersection(free).area > 0.8 * free.area, (plan.plan_id, room)
    assert len({plan.digest() for plan in plans}) == len(plans)


def test_kinds_differ_as_their_names_say():
    area_m2 = {kind: np.median([p.free_space().area for p in plans_of(kind, 24)[:15]]) for kind in KINDS}
    assert area_m2["apartment"] < area_m2["office"] < area_m2["hall"] < area_m2["large_hall"]
    assert all(p.rooms[0].category == "Corridor" for p in plans_of("office", 24)[:5])
    assert all(p.rooms[0].category == "Hall" and p.holes_m for p in plans_of("hall", 24)[:5])


def test_large_halls_are_wide_and_hold_rows_of_the_same():
    plans = plans_of("large_hall", 24)
    sides_m = np.array([np.ptp(plan.outline_m, axis=0).max() for plan in plans])
    assert sides_m.min() > 13.0
    assert np.quantile(sides_m, 0.9) > 22.0
    assert sides_m.max() < 33.0
    alike = []
    for plan in plans:
        assert plan.rooms[0].category == "Large_Hall"
        # The perimeter tells one kind of thing from another.
        lengths_m = [round(shapely.Polygon(hole).length, 2) for hole in plan.holes_m]
        alike.append(max(lengths_m.count(length_m) for length_m in lengths_m))
    assert np.median(alike) >= 6


def test_what_stands_in_a_warehouse_is_furniture():
    stalls_or_pallets = 0
    for plan in plans_of("warehouse", 24)[:4]:
        assert plan.rooms[0].category == "Warehouse"
        solids = furnish(plan, stream(0, plan.plan_id), density=1.0, robot_radius_m=RADIUS_M)
        stalls_or_pallets += len({s.item for s in solids if s.category in ("pallet", "stall")})
    assert stalls_or_pallets > 40


def test_a_kind_of_weight_zero_changes_no_draw():
    without = GeneratorParameters(apartment=0.3, office=0.3, hall=0.4)
    assert list(without.weights().values()) == [0.3, 0.3, 0.4, 0.0, 0.0]
    p = np.array([0.3, 0.3, 0.4])
    for seed in range(50):
        rng_3, rng_5 = np.random.default_rng(seed), np.random.default_rng(seed)
        assert rng_3.choice(3, p=p) == rng_5.choice(5, p=[*p, 0.0, 0.0])
        assert rng_3.random() == rng_5.random()


def test_the_collection_is_varied():
    plans = [generate_floorplan(stream(2, i), plan_id=f"p{i}", robot_radius_m=RADIUS_M) for i in range(60)]
    rooms = [len(plan.rooms) for plan in plans]
    sides_m = np.array([np.ptp(plan.outline_m, axis=0) for plan in plans]).max(axis=1)
    assert min(rooms) <= 5
    assert max(rooms) >= 12
    assert np.percentile(sides_m, 5) > 7.0
    assert np.percentile(sides_m, 95) < 20.0
    slanted = [_slanted_m(plan) > 1.0 for plan in plans]
    assert 0.15 < np.mean(slanted) < 0.55
    # Doors in a circle: the free space goes around some wall that stands free.
    assert np.mean([len(plan.holes_m) > 0 for plan in plans]) > 0.3
    assert all(len(start_regions(plan, robot_radius_m=RADIUS_M)) >= 2 for plan in plans)


def _slanted_m(plan: Floorplan) -> float:
    """Length of the outline that is more than 3 degrees off the axes, round pillars not counted."""
    step_m = np.roll(plan.outline_m, -1, axis=0) - plan.outline_m
    off_rad = np.abs(np.remainder(np.arctan2(step_m[:, 1], step_m[:, 0]) + np.pi / 4, np.pi / 2) - np.pi / 4)
    return float(np.linalg.norm(step_m[off_rad > np.radians(3.0)], axis=1).sum())


def test_a_plan_is_a_function_of_its_stream():
    a, b = (generate_floorplan(stream(5, "x"), plan_id="p", robot_radius_m=RADIUS_M) for _ in range(2))
    other = generate_floorplan(stream(6, "x"), plan_id="p", robot_radius_m=RADIUS_M)
    assert a.digest() == b.digest()
    assert a.rooms == b.rooms
    assert a.digest() != other.digest()


def test_walls_and_doors_keep_to_their_ranges():
    parameters = GeneratorParameters(
        apartment=1.0, office=0.0, hall=0.0, wall_thickness_m=(0.2, 0.2), door_width_m=(1.0, 1.0),
        slanted_share=0.0, niche_share=0.0, loop_share=0.0,
    )  # fmt: skip
    plan = generate_floorplan(
        stream(0, "ranges"), plan_id="p", parameters=parameters, robot_radius_m=RADIUS_M
    )
    free = plan.free_space()
    # A disc just wider than the doors reaches one room only, one just narrower reaches all.
    assert len(shapely.get_parts(free.buffer(-0.49))) < len(plan.rooms)
    assert len(start_regions(plan, robot_radius_m=RADIUS_M)) == len(plan.rooms)
    # The wall that two rooms share is 0.2 m thick: closing a gap of 0.22 m unites what lies apart by walls.
    assert free.buffer(0.09).buffer(-0.09).area == pytest.approx(free.area, rel=0.01)
    assert free.buffer(0.11).buffer(-0.11).area > 1.02 * free.area


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"apartment": -1.0}, "weights apartment -1.0, .* must not be negative, nor all zero"),
        ({"apartment": 0.0, "office": 0.0, "hall": 0.0}, "nor all zero"),
        ({"rooms": (2, 8)}, r"rooms is \(2, 8\); must be \(least, most\) within 3 to 20"),
        ({"door_width_m": (1.0, 0.8)}, r"door_width_m is \(1.0, 0.8\); must be \(least, most\) within"),
        ({"wall_thickness_m": (0.1, 0.5)}, r"wall_thickness_m is \(0.1, 0.5\)"),
    ],
)  # fmt: skip
def test_impossible_parameters_are_told(change: dict[str, float], message: str):
    with pytest.raises(FloorplanError, match=message):
        GeneratorParameters(**change)  # type: ignore[arg-type]


def test_parameters_that_contradict_each_other_are_told():
    parameters = GeneratorParameters(apartment=0.0, office=0.0, hall=1.0, rooms=(20, 20))
    with pytest.raises(FloorplanError, match=r"p: no valid plan in 50 attempts, the last one: \d+ rooms"):
        generate_floorplan(stream(0), plan_id="p", parameters=parameters, robot_radius_m=RADIUS_M)


def test_shipped_plans_are_what_the_generator_gives():
    plans = shipped_floorplans(24, robot_radius_m=RADIUS_M)
    assert sorted(p.name for p in SHIPPED.glob("*.json")) == [f"{plan.plan_id}.json" for plan in plans]
    for plan in plans:
        assert (SHIPPED / f"{plan.plan_id}.json").read_text() == houseexpo_json(plan)


def test_shipped_plans_are_valid_as_they_are():
    files = sorted(SHIPPED.glob("*.json"))
    assert len(files) == 24
    for file in files:
        plan = parse_floorplan(json.loads(file.read_text()), source=file.name)
        assert validated(plan, robot_radius_m=RADIUS_M).digest() == plan.digest()
