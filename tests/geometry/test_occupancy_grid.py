from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pytest import approx

from rendezvous.errors import MapError
from rendezvous.geometry.occupancy_grid import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    OccupancyGrid,
    grid_from_png,
    overlap,
)
from rendezvous.geometry.se2 import SE2


def grid_of(cells: object, *, T_m_g: SE2 | None = None, resolution_m: float = 0.5) -> OccupancyGrid:
    return OccupancyGrid(
        cells=np.array(cells, np.uint8), resolution_m=resolution_m, T_m_g=T_m_g or SE2.identity()
    )


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3, 3))
def test_every_cell_centre_lies_in_its_own_cell(x: float, y: float, yaw: float) -> None:
    grid = grid_of(np.arange(12).reshape(3, 4), T_m_g=SE2(x, y, yaw))
    centres = grid.cell_centres(np.ones((3, 4), bool))
    np.testing.assert_array_equal(grid.cell_of(centres), np.argwhere(np.ones((3, 4), bool)))
    np.testing.assert_array_equal(grid.sample(centres), np.arange(12))


def test_the_first_cell_lies_inside_the_origin_corner() -> None:
    grid = grid_of([[FREE, OCCUPIED], [UNKNOWN, FREE]], T_m_g=SE2(1.0, 2.0, 0.0))
    assert grid.cell_centres(grid.occupied()) == approx(np.array([[1.75, 2.25]]))


def test_outside_the_grid_all_is_unknown() -> None:
    grid = grid_of([[FREE] * 3] * 2)
    inside = np.array([[0.0, 0.0], [1.49, 0.1], [0.1, 0.99]])
    outside = np.array([[-0.01, 0.1], [0.1, -0.01], [1.5, 0.1], [0.1, 1.0], [9.0, 9.0]])
    assert (grid.sample(inside) == FREE).all()
    assert (grid.sample(outside) == UNKNOWN).all()


def test_cropping_takes_the_margin_only_where_the_grid_has_it() -> None:
    cells = np.full((6, 8), UNKNOWN, np.uint8)
    cells[0, 7] = FREE
    cropped = grid_of(cells).cropped(margin_cells=2)
    assert cropped.cells.shape == (3, 3)
    assert cropped.T_m_g == SE2(2.5, 0.0, 0.0)


def test_the_png_has_the_largest_y_on_top_and_comes_back() -> None:
    grid = grid_of([[OCCUPIED, FREE], [UNKNOWN, UNKNOWN], [FREE, FREE]], T_m_g=SE2(1.0, 2.0, 0.3))
    back = grid_from_png(grid.png(), resolution_m=grid.resolution_m, T_m_g=grid.T_m_g)
    np.testing.assert_array_equal(back.cells, grid.cells)
    import cv2

    image = cv2.imdecode(np.frombuffer(grid.png(), np.uint8), cv2.IMREAD_UNCHANGED)
    assert image[-1, 0] == OCCUPIED


def test_bytes_that_are_no_picture_are_refused() -> None:
    with pytest.raises(MapError, match="not a greyscale PNG"):
        grid_from_png(b"no picture", resolution_m=0.05, T_m_g=SE2.identity())


def test_cropping_keeps_every_known_cell_where_it_was() -> None:
    cells = np.full((40, 50), UNKNOWN, np.uint8)
    cells[12:20, 30:33] = FREE
    cells[14, 31] = OCCUPIED
    grid = grid_of(cells, T_m_g=SE2(-3.0, 1.0, 0.4))
    small = grid.cropped(margin_cells=1)
    assert small.cells.shape == (10, 5)
    p_m = grid.cell_centres(grid.known())
    np.testing.assert_array_equal(small.sample(p_m), grid.sample(p_m))
    assert small.known().sum() == grid.known().sum()


def test_an_empty_map_crops_to_something_small() -> None:
    assert grid_of(np.full((40, 50), UNKNOWN)).cropped(margin_cells=0).cells.shape == (1, 1)


def test_overlap_of_shifted_squares_is_analytic() -> None:
    square = grid_of(np.full((10, 10), FREE))
    assert overlap(square, square, SE2.identity()) == approx(1.0)
    # Half of each square covers the other: 50 / 150.
    assert overlap(square, square, SE2(2.5, 0.0, 0.0)) == approx(1 / 3)
    assert overlap(square, square, SE2(50.0, 0.0, 0.0)) == 0.0
    empty = grid_of(np.full((10, 10), UNKNOWN))
    assert overlap(empty, empty, SE2.identity()) == 0.0


def test_overlap_of_maps_of_two_resolutions_is_that_of_their_areas() -> None:
    coarse = grid_of(np.full((4, 4), FREE), resolution_m=0.5)
    fine = grid_of(np.full((10, 10), FREE), resolution_m=0.1)
    assert overlap(coarse, fine, SE2.identity()) == approx(1.0 / 4.0)
    assert overlap(fine, coarse, SE2.identity()) == approx(1.0 / 4.0)


@pytest.mark.parametrize("resolution_m", [np.float16(0.5), np.longdouble(0.5), np.array(0.5), Fraction(1, 2)])
def test_a_resolution_of_any_kind_of_number_is_kept_as_a_float(resolution_m):
    grid = OccupancyGrid(cells=np.zeros((2, 2), np.uint8), resolution_m=resolution_m, T_m_g=SE2.identity())
    assert type(grid.resolution_m) is float
    assert grid.resolution_m == 0.5


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"resolution_m": "fine"}, "resolution fine m; must be positive"),
        ({"resolution_m": None}, "resolution None m; must be positive"),
        ({"resolution_m": np.inf}, "resolution inf m; must be positive"),
        ({"resolution_m": 10**400}, "resolution 10"),
        ({"cells": [[0, 254]]}, "must be .H, W. uint8"),
        ({"cells": None}, "must be .H, W. uint8"),
        ({"T_m_g": (0.0, 0.0, 0.0)}, "T_m_g tuple; must be an SE2"),
    ],
)
def test_what_makes_no_grid_is_named(wrong, said):
    given = {"cells": np.zeros((2, 2), np.uint8), "resolution_m": 0.05, "T_m_g": SE2.identity()}
    with pytest.raises(MapError, match=said):
        OccupancyGrid(**(given | wrong))


def test_cropping_leaves_two_cells_of_margin_unless_told() -> None:
    cells = np.full((20, 30), UNKNOWN, np.uint8)
    cells[8:12, 10:15] = FREE
    cropped = grid_of(cells).cropped()
    assert cropped.cells.shape == (4 + 4, 5 + 4)
    assert cropped.T_m_g == SE2(0.5 * 8, 0.5 * 6, 0.0)


def test_a_picture_in_colour_is_no_map() -> None:
    import cv2

    _, png = cv2.imencode(".png", np.zeros((4, 5, 3), np.uint8))
    with pytest.raises(MapError, match="is not a greyscale PNG"):
        grid_from_png(png.tobytes(), resolution_m=0.05, T_m_g=SE2.identity())
