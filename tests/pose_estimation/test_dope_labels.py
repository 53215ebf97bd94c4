from __future__ import annotations

import numpy as np
import pytest
from PIL import Image, ImageDraw

from rendezvous.geometry.cuboid import pose_from_cuboid, project_cuboid
from rendezvous.pose_estimation.dope_labels import belief_maps, vector_fields
from tests.geometry.test_cuboid import CAMERA, SIZE_M, random_pose

SIZE_PX, STRIDE_PX = 400, 8
CELLS = SIZE_PX // STRIDE_PX


def _beliefs(uv_px: np.ndarray, **changed: float) -> np.ndarray:
    return belief_maps(
        uv_px,
        **{"width_px": SIZE_PX, "height_px": SIZE_PX, "stride_px": STRIDE_PX, "sigma_cells": 0.5, **changed},
    )


def _fields(uv_px: np.ndarray, **changed: int) -> np.ndarray:
    return vector_fields(
        uv_px, **{"width_px": SIZE_PX, "height_px": SIZE_PX, "stride_px": STRIDE_PX, **changed}
    )


def _objects(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 9, 2) points of cuboids, some of them partly outside of the picture."""
    return np.stack([project_cuboid(random_pose(rng), SIZE_M, CAMERA) - [120.0, 40.0] for _ in range(count)])


def _official_belief(points: np.ndarray, *, sigma: float) -> np.ndarray:
    """One channel by the rule that DOPE's training states: points (N, 2) in cells, maps of CELLS x CELLS."""
    belief = np.zeros((CELLS, CELLS))
    w = int(2 * sigma)
    for u, v in points:
        if min(u, v) - w < 0 or max(u, v) + w >= CELLS:
            continue
        for row in range(CELLS):
            for col in range(CELLS):
                if abs(row - int(v)) <= w and abs(col - int(u)) <= w:
                    d2 = (row - v) ** 2 + (col - u) ** 2
                    belief[row, col] = max(belief[row, col], np.exp(-0.5 * d2 / sigma**2))
    return belief


@pytest.mark.parametrize("sigma", [0.5, 2.0])
def test_belief_maps_follow_dopes_rule(sigma):
    uv_px = _objects(np.random.default_rng(0), 3)
    maps = _beliefs(uv_px, sigma_cells=sigma)
    assert maps.shape == (9, CELLS, CELLS)
    assert maps.dtype == np.float32
    for channel in range(9):
        expected = _official_belief(uv_px[:, channel] / STRIDE_PX, sigma=sigma)
        assert np.allclose(maps[channel], expected, atol=1e-6)
    assert maps.max() > 0.5


def _official_disc(u: float, v: float) -> np.ndarray:
    """The cells that DOPE's training paints around a vertex: an ellipse of Pillow, radius 1."""
    image = Image.new("L", (CELLS, CELLS))
    ImageDraw.Draw(image).ellipse((u - 1, v - 1, u + 1, v + 1), 1)
    return np.asarray(image) > 0


def test_vector_fields_follow_dopes_rule():
    rng = np.random.default_rng(1)
    for _ in range(20):
        uv_px = _objects(rng, 1)
        fields = _fields(uv_px).reshape(8, 2, CELLS, CELLS)
        cells = uv_px[0] / STRIDE_PX
        for i in range(8):
            if (cells[i] < 1.0).any():  # Pillow rounds negative coordinates towards zero
                continue
            disc = _official_disc(*cells[i])
            towards = (cells[8] - cells[i]) / np.linalg.norm(cells[8] - cells[i])
            assert np.allclose(fields[i], towards[:, None, None] * disc, atol=1e-6)


def test_vectors_are_of_unit_length_or_zero():
    fields = _fields(_objects(np.random.default_rng(2), 6)).reshape(8, 2, CELLS, CELLS)
    norms = np.linalg.norm(fields, axis=1)
    assert norms[norms > 0.0] == pytest.approx(1.0, abs=1e-6)
    assert 30 <= (norms > 0.0).sum() <= 6 * 8 * 5


def _single(points: dict[int, tuple[float, float]]) -> np.ndarray:
    """(1, 9, 2) with only some points known."""
    uv_px = np.full((1, 9, 2), np.nan)
    for i, point in points.items():
        uv_px[0, i] = point
    return uv_px


def test_a_point_on_a_cell_has_belief_one_there():
    maps = _beliefs(_single({4: (80.0, 160.0)}))
    assert np.unravel_index(maps.argmax(), maps.shape) == (4, 20, 10)
    assert maps.max() == 1.0
    assert maps[4, 20, 11] == pytest.approx(np.exp(-2.0))
    assert np.count_nonzero(maps) == 9


@pytest.mark.parametrize(("u_px", "drawn"), [(7.9, False), (8.0, True), (391.9, True), (392.0, False)])
def test_a_point_near_the_border_is_skipped(u_px, drawn):
    assert _beliefs(_single({0: (u_px, 200.0)})).any() == drawn
    assert _beliefs(_single({0: (200.0, u_px)})).any() == drawn


def test_what_is_not_known_leaves_no_trace():
    unknown = _single({})
    assert not _beliefs(unknown).any()
    assert not _fields(unknown).any()
    assert not _fields(_single({0: (80.0, 80.0)})).any()  # no centroid to point to
    assert _beliefs(np.empty((0, 9, 2))).shape == (9, CELLS, CELLS)


def test_two_objects_on_one_cell_share_the_mean_direction():
    one, other = _single({0: (80.0, 80.0), 8: (160.0, 80.0)}), _single({0: (80.0, 80.0), 8: (80.0, 160.0)})
    fields = _fields(np.concatenate([one, other]))
    assert fields[:2, 10, 10] == pytest.approx([np.sqrt(0.5)] * 2)


def test_where_two_objects_meet_the_larger_belief_stays():
    one, other = _single({4: (80.0, 160.0)}), _single({4: (90.0, 160.0)})
    both = _beliefs(np.concatenate([one, other]))
    assert np.array_equal(both, np.maximum(_beliefs(one), _beliefs(other)))
    assert 0.0 < _beliefs(other)[4, 20, 10] < _beliefs(one)[4, 20, 10] == both[4, 20, 10]


@pytest.mark.parametrize("stride_px", [1, 2, 4, 8, 16])
def test_any_stride_and_size_puts_the_peak_on_the_point(stride_px):
    uv_px = _single({8: (304.0, 96.0)})
    maps = belief_maps(uv_px, width_px=640, height_px=480, stride_px=stride_px, sigma_cells=0.5)
    assert maps.shape == (9, 480 // stride_px, 640 // stride_px)
    _, row, col = np.unravel_index(maps.argmax(), maps.shape)
    assert (stride_px * col, stride_px * row) == (304.0, 96.0)
    assert vector_fields(uv_px, width_px=640, height_px=480, stride_px=stride_px).shape[0] == 16


def test_the_pose_comes_back_from_the_maps():
    # Sub-cell peaks by the mean weighted with belief, as DOPE reads its maps.
    T_c_o = np.eye(4)
    T_c_o[:3, :3] = np.array([[0.6, -0.8, 0.0], [0.0, 0.0, -1.0], [0.8, 0.6, 0.0]])
    T_c_o[:3, 3] = 0.02, 0.03, 0.5
    uv_px = project_cuboid(T_c_o, SIZE_M, CAMERA)
    maps = belief_maps(uv_px[None], width_px=640, height_px=480, stride_px=2, sigma_cells=3.0)
    rows, cols = np.mgrid[0:240, 0:320]
    weights = maps.sum(axis=(1, 2))
    peaks = 2.0 * np.stack([(maps * cols).sum(axis=(1, 2)), (maps * rows).sum(axis=(1, 2))], axis=1)
    found = pose_from_cuboid(peaks / weights[:, None], SIZE_M, CAMERA)
    assert found is not None
    assert found == pytest.approx(T_c_o, abs=5e-3)
