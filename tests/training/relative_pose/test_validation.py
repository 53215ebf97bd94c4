"""Belief maps over inputs, as TensorBoard shows them."""

from __future__ import annotations

import numpy as np
import pytest

from rendezvous.training.relative_pose.data import PoseSample
from rendezvous.training.relative_pose.validation import sheet


def test_a_peak_is_painted_over_the_point_that_it_stands_for():
    image = np.zeros((64, 64, 3), np.uint8)
    image[40, 24] = 255
    belief = np.zeros((9, 8, 8), np.float32)
    belief[2, 5, 3] = 1.0
    sample = PoseSample(image=image, uv_px=np.full((9, 2), np.nan), close=True)
    plain, painted = (sheet([sample], [maps], columns=1).astype(float) for maps in (0.0 * belief, belief))
    # Without the frame at the right and lower edge.
    weights = [panel[:-1, :-1].sum(axis=2) for panel in (plain, painted - plain)]
    rows, cols = np.mgrid[:127, :127]
    places = [[(w * rows).sum() / w.sum(), (w * cols).sum() / w.sum()] for w in weights]
    assert places[0] == pytest.approx([80.5, 48.5], abs=0.1)
    assert places[1] == pytest.approx(places[0], abs=0.3)


def test_a_sheet_is_filled_row_by_row_and_its_rest_is_black():
    samples = [
        PoseSample(image=np.full((16, 16, 3), 10 * k, np.uint8), uv_px=np.full((9, 2), np.nan), close=True)
        for k in (5, 10, 20)
    ]
    shown = sheet(samples, [np.zeros((9, 2, 2), np.float32)] * 3, columns=2)
    assert shown.shape == (64, 64, 3)
    assert [int(shown[v, u, 0]) for v, u in ((10, 10), (10, 42), (42, 10), (42, 42))] == [30, 60, 120, 0]
