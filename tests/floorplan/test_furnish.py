from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import shapely

from rendezvous.errors import FloorplanError
from rendezvous.floorplan import catalogue
from rendezvous.floorplan.furnish import (
    _category,
    _FloorSpace,
    _free_poses,
    _wall_poses,
    _wall_spots,
    furnish,
)
from rendezvous.floorplan.records import Floorplan, Room, Shape, Solid
from rendezvous.floorplan.site import CELL_M, Site
from rendezvous.floorplan.validate import reachable_space, start_regions, validated
from rendezvous.seeds import stream
from tests.floorplan.plans import RADIUS_M, TWO_ROOMS, generated, genuine, plan_of

LIDAR_M = 0.182
ROBOT_HEIGHT_M = 0.192


def footprint(solid: Solid) -> shapely.Polygon:
    if solid.shape is Shape.CYLINDER:
        return shapely.Point(solid.x_m, solid.y_m).buffer(solid.half_x_m)
    return shapely.Polygon(solid.corners_m())


def check_connected(plan: Floorplan, solids: tuple[Solid, ...], radius_m: float) -> None:
    """Exact polygons, nothing of the grid: a robot of this radius still gets nearly everywhere."""
    standing = shapely.union_all([footprint(s) for s in solids if s.z0_m < ROBOT_HEIGHT_M])
    before = reachable_space(plan, robot_radius_m=radius_m)
    pieces = shapely.get_parts(before.difference(standing.buffer(radius_m)))
    largest = max(pieces, key=shapely.area)
    pockets_m2 = sum(piece.area for piece in pieces) - largest.area
    assert pockets_m2 < 0.1 * largest.area
    for region in start_regions(plan, robot_radius_m=RADIUS_M):
        assert region.intersection(largest).area > 0.3 * region.area


@pytest.mark.parametrize("density", [1.0, 2.0])
@pytest.mark.parametrize("index", range(8))
def test_a_robot_still_gets_everywhere(index: int, density: float):
    plan = generated(index)
    solids = furnish(plan, stream(0, "furnish", index), density=density, robot_radius_m=RADIUS_M)
    check_connected(plan, solids, RADIUS_M)
    check_connected(plan, solids, RADIUS_M + 0.04)


def test_a_robot_still_gets_everywhere_in_genuine_plans(real_data: Path):
    for read in genuine(real_data):
        plan = validated(read, robot_radius_m=RADIUS_M)
        for episode in range(4):
            check_connected(
                plan,
                furnish(plan, stream(0, plan.plan_id, episode), density=1.5, robot_radius_m=RADIUS_M),
                RADIUS_M,
            )


@pytest.mark.parametrize("index", range(12))
def test_furniture_is_inside_seen_by_the_lidar_or_above_the_robot(index: int):
    plan = generated(index)
    solids = furnish(plan, stream(0, "furnish", index), density=1.5, robot_radius_m=RADIUS_M)
    assert solids
    free = plan.free_space().buffer(1e-6)
    for solid in solids:
        assert free.covers(footprint(solid)), solid
        if solid.z0_m == 0.0:
            assert solid.z1_m >= 0.25 > LIDAR_M
        else:
            assert solid.z0_m >= 0.4 > ROBOT_HEIGHT_M


@pytest.mark.parametrize("index", range(12))
def test_pieces_do_not_stand_in_each_other(index: int):
    solids = furnish(generated(index), stream(0, "furnish", index), density=1.5, robot_radius_m=RADIUS_M)
    items = [
        shapely.union_all([footprint(s) for s in solids if s.item == item])
        for item in range(1 + max(s.item for s in solids))
    ]
    assert len(items) > 1
    for i, item in enumerate(items):
        for other in items[:i]:
            assert item.intersection(other).area == 0.0


def test_doorways_stay_clear():
    plan = plan_of(TWO_ROOMS)
    doorway = shapely.box(4.0 - 0.6, 1.5, 4.0 + 0.6, 2.4)
    placed = 0
    for episode in range(60):
        solids = furnish(plan, stream(0, "door", episode), density=2.5, robot_radius_m=RADIUS_M)
        placed += len(solids)
        assert not any(footprint(s).intersects(doorway) for s in solids if s.z0_m < 0.4)
    assert placed > 500


def test_density_sets_how_full_it_is():
    plan = generated(0)
    share = [
        np.mean(
            [
                _floor_share(plan, furnish(plan, stream(0, e), density=density, robot_radius_m=RADIUS_M))
                for e in range(8)
            ]
        )
        for density in (0.3, 1.0, 2.0)
    ]
    assert 0.01 < share[0] < share[1] < share[2] < 0.5
    assert furnish(plan, stream(0), density=0.0, robot_radius_m=RADIUS_M) == ()


def _floor_share(plan: Floorplan, solids: tuple[Solid, ...]) -> float:
    return float(shapely.union_all([footprint(s) for s in solids]).area / plan.free_space().area)


def test_density_out_of_range_is_told():
    with pytest.raises(
        FloorplanError, match=r"furniture density -1; must be from 0 \(none\) to 3 \(packed\)"
    ):
        furnish(generated(0), stream(0), density=-1, robot_radius_m=RADIUS_M)


def test_furniture_is_a_function_of_its_stream():
    plan = generated(1)
    assert furnish(plan, stream(3), density=1.0, robot_radius_m=RADIUS_M) == furnish(
        plan, stream(3), density=1.0, robot_radius_m=RADIUS_M
    )
    assert furnish(plan, stream(3), density=1.0, robot_radius_m=RADIUS_M) != furnish(
        plan, stream(4), density=1.0, robot_radius_m=RADIUS_M
    )


def test_a_wider_robot_has_less_room_between_the_walls():
    walls = shapely.Polygon(TWO_ROOMS).boundary
    for radius_m in (0.105, 0.25):
        site = Site(plan_of(TWO_ROOMS), robot_radius_m=radius_m)
        row, col = np.nonzero(site.reachable)
        centres_m = site.origin_m + CELL_M * (np.stack([col, row], axis=1) + 0.5)
        nearest_m = shapely.distance(shapely.points(centres_m), walls).min()
        assert radius_m + 0.03 < nearest_m < radius_m + 0.12


def test_free_pieces_are_tried_within_their_room():
    plan = generated(0)
    site = Site(plan, robot_radius_m=RADIUS_M)
    spots = _wall_spots(plan, site)
    for number, (cells, room_spots) in enumerate(zip(site.cells_per_room(), spots, strict=True), start=1):
        room = _FloorSpace(site=site, cells=cells, spots=room_spots)
        poses = np.concatenate([_free_poses(room, stream(0, "free", k)) for k in range(10)])
        # Drawn from every fourth cell, within twice its side: few end up in the wall or the next room.
        assert np.mean(site.room_at(poses[:, :2]) == number) > 0.9
    assert site.room_count >= 3


def test_items_are_numbered_without_gaps():
    items = [solid.item for solid in furnish(generated(2), stream(0), density=1.0, robot_radius_m=RADIUS_M)]
    assert items == sorted(items)
    assert set(items) == set(range(max(items) + 1))


def test_rooms_get_what_belongs_in_them():
    found: dict[str, set[str]] = {}
    for index in range(20):
        plan = generated(index)
        for solid in furnish(plan, stream(0, "rooms", index), density=1.0, robot_radius_m=RADIUS_M):
            at = shapely.Point(solid.x_m, solid.y_m)
            inside = {room.category for room in plan.rooms if shapely.box(*room.box_m).contains(at)}
            if len(inside) == 1:
                found.setdefault(solid.category, set()).update(inside)
    assert found["bed"] <= {"Bedroom", "Guest_Room", "Child_Room"}
    assert found["toilet"] <= {"Bathroom", "Toilet"}
    assert "Office" in found["desk"]


@pytest.mark.parametrize("index", range(20))
def test_every_start_region_is_a_room_of_its_own(index: int):
    plan = generated(index)
    site = Site(plan, robot_radius_m=RADIUS_M)
    regions = start_regions(plan, robot_radius_m=RADIUS_M)
    assert site.room_count == len(regions)
    for room, region in enumerate(regions, start=1):
        point = region.representative_point()
        assert site.room_at(np.array([[point.x, point.y]])) == [room]
    assert [len(cells) > 0 for cells in site.cells_per_room()] == [True] * len(regions)


def test_pieces_stand_with_their_backs_a_few_centimetres_from_a_wall():
    """A wall along y = 2 with free space above: what stands there looks up, which is a yaw of 0."""
    wardrobe = catalogue.wardrobe(np.random.default_rng(0))
    spots = np.array([[1.0, 2.0, 0.5 * np.pi], [3.0, 2.0, 0.5 * np.pi]])
    rng = np.random.default_rng(1)
    poses = np.concatenate([_wall_poses(wardrobe, spots, rng) for _ in range(40)])
    assert set(poses[:, 0].round(9)) == {1.0, 3.0}
    gaps_m = poses[:, 1] - 2.0 - wardrobe.half_y_m
    assert gaps_m.min() == pytest.approx(0.01, abs=0.002)
    assert gaps_m.max() == pytest.approx(0.08, abs=0.002)
    assert poses[:, 2].mean() == pytest.approx(0.0, abs=0.003)
    assert poses[:, 2].std() == pytest.approx(0.01, rel=0.2)


@pytest.mark.parametrize(
    ("boxes_m", "category"),
    [
        ([(1.0, 1.0, 2.3, 5.0)], "a"),  # an intersection over union of a third
        ([(1.0, 1.0, 2.1, 5.0)], ""),  # of a quarter
        ([(1.0, 1.0, 4.0, 5.0), (1.0, 1.0, 5.0, 5.0), (0.0, 0.0, 9.0, 9.0)], "b"),
        ([(6.0, 6.0, 9.0, 9.0)], ""),
        ([], ""),
    ],
)
def test_a_room_is_what_the_label_that_fits_it_best_says(boxes_m, category: str):
    cells = np.argwhere(np.ones((200, 200), bool))
    site = SimpleNamespace(origin_m=np.array([1.0, 1.0]))
    room = SimpleNamespace(site=site, cells=cells * (4.0 / 200 / CELL_M))
    labels = tuple(Room(category=name, box_m=box_m) for name, box_m in zip("abc", boxes_m, strict=False))
    assert _category(room, labels) == category


def test_spots_lie_evenly_along_walls_and_face_into_their_rooms():
    plan = plan_of(TWO_ROOMS)
    spots = _wall_spots(plan, Site(plan, robot_radius_m=RADIUS_M))
    assert len(spots) == 2
    for of_room, west in zip(sorted(spots, key=lambda s: s[:, 0].mean()), (True, False), strict=True):
        ahead = of_room[:, :2] + 0.1 * np.stack([np.cos(of_room[:, 2]), np.sin(of_room[:, 2])], axis=1)
        room = shapely.box(0.0, 0.0, 3.95, 4.0) if west else shapely.box(4.05, 0.0, 8.0, 4.0)
        within = shapely.contains_xy(room, ahead)
        assert within.mean() > 0.9  # all but those in the doorway
        on_wall = shapely.distance(plan.free_space().boundary, shapely.points(of_room[:, :2]))
        assert on_wall.max() < 1e-9
        south = np.sort(of_room[(of_room[:, 1] == 0.0), 0])
        assert np.diff(south) == pytest.approx(3.95 / 19, abs=1e-6)  # 19 stretches of at least 0.2 m
        assert south[0] - room.bounds[0] == pytest.approx(0.5 * 3.95 / 19)
