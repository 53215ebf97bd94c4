"""Surface elements: means weighted by variance, one for each face, fixed once they weigh enough."""

from __future__ import annotations

import math

import numpy as np
from pytest import approx

from rendezvous.geometry.se2 import Array
from rendezvous.slam.surface_map import LENGTH, NX, NY, WEIGHT, SurfaceMap, X, Y, nearest

ORIGIN = np.zeros(3)


def surface(*, max_weight: float = 60.0) -> SurfaceMap:
    return SurfaceMap(extent_m=4.0, cell_m=0.1, same_side=0.7, max_weight=max_weight)


def insert(
    seen: SurfaceMap, point: tuple[float, float], normal: tuple[float, float], sigma_m: float
) -> Array:
    """Insert one point; the first element after that."""
    seen.insert(np.array([point]), np.array([normal]), np.array([sigma_m]), ORIGIN)
    return seen.surface.elements[0]


def test_an_element_is_the_mean_of_its_points_weighted_by_their_variances() -> None:
    seen = surface()
    insert(seen, (1.02, 0.04), (-1.0, 0.0), 0.01)
    tilt = (-math.cos(0.2), math.sin(0.2))
    element = insert(seen, (1.06, 0.08), tilt, 0.02)  # a quarter of the first one's weight
    assert (element[X], element[Y]) == approx((1.028, 0.048))
    mean = 0.8 * np.array([-1.0, 0.0]) + 0.2 * np.array(tilt)
    assert element[LENGTH] == approx(np.linalg.norm(mean))
    assert (element[NX], element[NY]) == approx(tuple(mean / np.linalg.norm(mean)))
    assert element[WEIGHT] == approx(1.25)
    # The next one counts each normal of before once, not the unit vector of their mean.
    element = insert(seen, (1.028, 0.048), (-1.0, 0.0), 0.01)
    mean = (2.0 * np.array([-1.0, 0.0]) + 0.25 * np.array(tilt)) / 2.25
    assert element[LENGTH] == approx(np.linalg.norm(mean))


def test_an_element_of_full_weight_moves_no_more() -> None:
    seen = surface(max_weight=2.0)
    for _ in range(2):
        insert(seen, (1.02, 0.04), (-1.0, 0.0), 0.01)
    before = seen.surface.elements[0].copy()
    np.testing.assert_array_equal(insert(seen, (1.08, 0.08), (-1.0, 0.0), 0.01), before)


def test_points_are_carried_by_the_pose_and_keep_their_side() -> None:
    seen = surface()
    pose = np.array([0.3, -0.2, 0.5 * math.pi])
    seen.insert(np.array([[1.0, 0.04]]), np.array([[-1.0, 0.0]]), np.array([0.01]), pose)
    element = seen.surface.elements[0]
    assert element[[X, Y, NX, NY]] == approx([0.26, 0.8, 0.0, -1.0])


def test_the_nearest_element_within_the_gate_and_of_the_same_side_is_found() -> None:
    seen = surface()
    for k, (point, normal) in enumerate(
        (((1.02, 0.04), (-1.0, 0.0)), ((1.08, 0.06), (1.0, 0.0)), ((0.91, 0.04), (-1.0, 0.0)))
    ):
        insert(seen, point, normal, 0.01)
        assert seen.surface.elements[k, X] == approx(point[0])
    assert nearest(1.07, 0.04, -1.0, 0.0, seen.surface, 0.15) == 0
    assert nearest(1.07, 0.04, 1.0, 0.0, seen.surface, 0.15) == 1
    assert nearest(0.93, 0.04, -1.0, 0.0, seen.surface, 0.15) == 2
    assert nearest(0.93, 0.04, -1.0, 0.0, seen.surface, 0.015) == -1
    assert nearest(0.93, 0.04, 0.0, 1.0, seen.surface, 0.15) == -1


def test_a_surface_grows_past_its_first_4096_elements() -> None:
    seen = SurfaceMap(extent_m=400.0, cell_m=0.1, same_side=0.7, max_weight=60.0)
    for k in range(3):
        x_m = -150.0 + 0.1 * np.arange(2000) + 0.05
        points = np.stack([x_m, np.full(2000, 1.05 + k)], axis=1)
        seen.insert(points, np.tile([0.0, -1.0], (2000, 1)), np.full(2000, 0.01), ORIGIN)
    assert seen.surface.elements[5999, [X, Y]] == approx([x_m[-1], 3.05])
    assert nearest(-149.95, 1.05, 0.0, -1.0, seen.surface, 0.15) == 0


def test_the_nearest_element_may_lie_in_any_cell_around() -> None:
    for dx in (-0.04, 0.0, 0.04):
        for dy in (-0.04, 0.0, 0.04):
            seen = surface()
            # The point lies 1 cm or less from a corner of its cell, on the side where the element is.
            x, y = 0.05 + dx, 0.05 + dy
            insert(seen, (x + dx, y + dy), (1.0, 0.0), 0.01)
            assert nearest(x, y, 1.0, 0.0, seen.surface, 0.15) == 0
