from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rendezvous.evaluation.pictures.canvas import (
    BLUE,
    INK,
    PAPER,
    Canvas,
    View,
    fitted_view,
    text_width_px,
)

coordinates = st.floats(-50, 50)


@given(st.floats(1, 100), coordinates, coordinates, coordinates, coordinates)
def test_metres_and_pixels_are_inverse(px_per_m, u0_px, v0_px, x_m, y_m):
    view = View(px_per_m=px_per_m, u0_px=u0_px, v0_px=v0_px)
    p_m = np.array([[x_m, y_m]])
    assert view.p_m(view.uv_px(p_m)) == pytest.approx(p_m, abs=1e-9)


def test_north_is_up_and_the_middle_is_in_the_middle():
    view = fitted_view(np.array([1.0, 2.0]), np.array([3.0, 6.0]), px_per_m=10.0, centre_uv_px=(50.0, 40.0))
    assert view.uv_px(np.array([[2.0, 4.0], [2.0, 5.0], [3.0, 4.0]])).tolist() == [
        [50.0, 40.0],
        [50.0, 30.0],
        [60.0, 40.0],
    ]


def test_rings_leave_their_holes_open():
    canvas = Canvas(40, 40)
    outer = np.array([[5.0, 5.0], [35.0, 5.0], [35.0, 35.0], [5.0, 35.0]])
    inner = np.array([[15.0, 15.0], [25.0, 15.0], [25.0, 25.0], [15.0, 25.0]])
    canvas.rings([outer, inner], colour=BLUE)
    assert tuple(canvas.image[10, 10]) == BLUE
    assert tuple(canvas.image[20, 20]) == PAPER


@pytest.mark.parametrize("right", [False, True])
def test_text_starts_or_ends_at_its_pixel_and_has_the_width_it_says(right):
    canvas = Canvas(300, 60)
    end_px = canvas.text("overlap 0.17", 200 if right else 100, 40, size_px=24, right=right)
    inked = np.flatnonzero((canvas.image != PAPER).any(axis=(0, 2)))
    start_px = 200 - text_width_px("overlap 0.17", size_px=24) if right else 100
    assert end_px == start_px + text_width_px("overlap 0.17", size_px=24)
    assert (inked[0], inked[-1]) == (pytest.approx(start_px, abs=3), pytest.approx(end_px, abs=3))


@pytest.mark.parametrize(("px_per_m", "metres"), [(60.0, 2), (30.0, 5), (12.0, 10), (150.0, 1)])
def test_scale_bar_has_the_length_it_names(px_per_m, metres):
    canvas = Canvas(400, 40)
    canvas.scale_bar(20, 20, px_per_m=px_per_m, longest_px=160)
    bar = (canvas.image[20] == INK).all(axis=1)
    gap = int(np.argmin(bar[25:])) + 25
    assert gap - 20 == pytest.approx(metres * px_per_m, abs=3)
