from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from shapely.affinity import rotate, translate

from rendezvous.floorplan.catalogue import Maker
from rendezvous.floorplan.furnish import GENERIC, RECIPES, recipe_for
from rendezvous.floorplan.records import DRIVE_UNDER_M, Shape, Solid

MAKERS = sorted(
    {make for recipe in (GENERIC, *RECIPES.values()) for make in (*recipe.first, *recipe.then)},
    key=lambda make: f"{make.__name__} {make(np.random.default_rng(0)).category}",
)


def name_of(make: Maker) -> str:
    return make(np.random.default_rng(0)).category


def footprint(solid: Solid) -> shapely.Polygon:
    if solid.shape is Shape.CYLINDER:
        return shapely.Point(solid.x_m, solid.y_m).buffer(solid.half_x_m)
    return shapely.Polygon(solid.corners_m())


@pytest.mark.parametrize("make", MAKERS, ids=name_of)
def test_pieces_fill_their_rectangle_and_stand_or_hang(make: Maker):
    for seed in range(30):
        piece = make(np.random.default_rng(seed))
        solids = piece.placed(np.zeros(3), item=7)
        shape = shapely.union_all([footprint(solid) for solid in solids])
        rectangle = (-piece.half_x_m, -piece.half_y_m, piece.half_x_m, piece.half_y_m)
        assert shape.bounds == pytest.approx(rectangle, abs=1e-9)
        for solid in solids:
            assert (solid.category, solid.item) == (piece.category, 7)
            standing = solid.z0_m == 0.0
            assert solid.z1_m >= 0.25 if standing else solid.z0_m >= DRIVE_UNDER_M
        assert any(solid.z0_m == 0.0 for solid in solids)


@pytest.mark.parametrize("make", MAKERS, ids=name_of)
def test_what_stands_on_the_floor_is_where_its_solids_are(make: Maker):
    piece = make(np.random.default_rng(1))
    pose = np.array([3.0, -2.0, 0.7])
    placed = [s for s in piece.placed(pose, item=0) if s.z0_m < DRIVE_UNDER_M]
    rows = np.concatenate([piece.standing_at(pose, shape) for shape in Shape])
    expected = [[s.x_m, s.y_m, s.yaw_rad, s.half_x_m, s.half_y_m] for s in placed]
    np.testing.assert_allclose(sorted(rows.tolist()), sorted(expected))


def test_placing_turns_about_the_middle_of_the_piece():
    piece = RECIPES["Office"].first[0](np.random.default_rng(2))
    at_origin = shapely.union_all([footprint(s) for s in piece.placed(np.zeros(3), item=0)])
    moved = shapely.union_all([footprint(s) for s in piece.placed(np.array([1.0, 2.0, 0.5]), item=0)])
    expected = translate(rotate(at_origin, math.degrees(0.5), origin=(0, 0)), 1.0, 2.0)
    assert moved.symmetric_difference(expected).area < 0.01 * moved.area


def test_rooms_of_unknown_use_get_a_mixture_and_small_halls_are_hallways():
    assert recipe_for("Aeration", area_m2=12.0) is GENERIC
    assert recipe_for("Child_Room", area_m2=12.0) is RECIPES["Bedroom"]
    assert recipe_for("Hall", area_m2=8.0) is RECIPES["Corridor"]
    assert recipe_for("Hall", area_m2=60.0) is RECIPES["Hall"]
