"""Maps whose unknown cells map_server's thresholds would free, and maps in other programs' greys."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from rendezvous.errors import MapError
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN
from rendezvous.interop.ros_map import read_ros_map

RNG = np.random.default_rng(0)


def room() -> np.ndarray:
    """(60, 80) uint8 greys of map_saver, top row first: a room amid what is unknown."""
    greys = np.full((60, 80), UNKNOWN, np.uint8)
    greys[15:45, 20:60] = OCCUPIED
    greys[16:44, 21:59] = FREE
    return greys


def saved(folder: Path, pixels: np.ndarray, *, suffix: str = ".png", **fields: object) -> Path:
    (folder / f"map{suffix}").write_bytes(cv2.imencode(suffix, pixels)[1].tobytes())
    keys = {"image": f"map{suffix}", "resolution": 0.05, "origin": [0, 0, 0], **fields}
    (folder / "map.yaml").write_text("".join(f"{key}: {value}\n" for key, value in keys.items()))
    return folder / "map.yaml"


def read(path: Path, *, strict: bool = False) -> tuple[np.ndarray, list[str]]:
    """The cells, top row first, and the warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        cells = read_ros_map(path, strict=strict).cells[::-1]
    return cells, [str(warning.message) for warning in caught]


def with_stray(greys: np.ndarray, *values: int) -> np.ndarray:
    stray = greys.copy()
    stray[0, : len(values)] = values
    return stray


def noisy(greys: np.ndarray) -> np.ndarray:
    return np.clip(greys + RNG.normal(0.0, 1.5, greys.shape), 0, 255).astype(np.uint8)


def with_alpha(greys: np.ndarray, alpha: int = 255) -> np.ndarray:
    return np.dstack([greys, greys, greys, np.full_like(greys, alpha)])


def with_transparent_row(greys: np.ndarray) -> np.ndarray:
    pixels = with_alpha(greys)
    pixels[0, :, 3] = 0
    return pixels


def grey_of(*levels: int) -> np.ndarray:
    """The room with other greys for occupied, unknown and free."""
    table = np.zeros(256, np.uint8)
    table[[OCCUPIED, UNKNOWN, FREE]] = levels
    return table[room()]


LOOSE = {"free_thresh": 0.25}
GUARDED: dict[str, tuple[Callable[[], np.ndarray], dict[str, object]]] = {
    "free_thresh of an old nav2": (room, LOOSE),
    "one stray pixel": (lambda: with_stray(room(), 128), LOOSE),
    "many stray pixels": (lambda: with_stray(room(), *range(2, 60)), LOOSE),
    "painted over in white": (lambda: np.where(room() == FREE, np.uint8(255), room()), LOOSE),
    "all unknown but a pixel": (lambda: with_stray(np.full((40, 40), 205, np.uint8), 128), LOOSE),
    "an opaque alpha channel": (lambda: with_alpha(room()), {}),
    "an opaque alpha channel and a stray pixel": (lambda: with_alpha(with_stray(room(), 128)), {}),
    "a nearly opaque alpha channel": (lambda: with_alpha(room(), 250), {}),
    "16 bits": (lambda: room().astype(np.uint16) * 257, LOOSE),
    "16 bits with alpha": (lambda: with_alpha(room()).astype(np.uint16) * 257, {}),
    "contrast stretched to 255": (lambda: grey_of(0, 206, 255), {}),
    "brightened": (lambda: grey_of(10, 215, 255), {}),
    "another unknown grey": (lambda: grey_of(0, 190, 250), {"free_thresh": 0.3}),
    "RTAB-Map's, thresholds too loose": (
        lambda: grey_of(0, 89, 178),
        {"free_thresh": 0.7, "occupied_thresh": 0.8},
    ),
    "noise of a lossy copy": (lambda: noisy(room()), LOOSE),
    "mode scale with a transparent row": (lambda: with_transparent_row(room()), {"mode": "scale", **LOOSE}),
    "a large part painted in another grey": (
        lambda: np.vstack([room(), np.full((90, 80), 128, np.uint8)]),
        LOOSE,
    ),
    "negated": (lambda: 255 - room(), {"negate": 1, **LOOSE}),
    "negated, with a stray pixel": (lambda: with_stray(255 - room(), 100), {"negate": 1, **LOOSE}),
    "equal thresholds": (room, {"free_thresh": 0.5, "occupied_thresh": 0.5}),
    "mode scale": (room, {"mode": "scale", **LOOSE}),
}


@pytest.mark.parametrize("case", GUARDED)
def test_unknown_cells_that_the_thresholds_would_free_stay_unknown(tmp_path: Path, case: str):
    make, fields = GUARDED[case]
    path = saved(tmp_path, make(), **fields)
    height = len(room())
    cells, said = read(path)
    expected = room() if "all unknown" not in case else np.full((40, 40), UNKNOWN)
    wrong = (cells[:height] != expected)[1:]  # strays lie in the first row
    assert wrong.mean() < (0.005 if "noise" in case else 1e-9), case
    (said,) = said
    assert "cells are read as unknown" in said
    strictly, nothing = read(path, strict=True)
    assert (strictly[: len(expected)][expected == UNKNOWN] == FREE).mean() > 0.9
    assert not nothing


def test_soft_edges_are_free_only_if_brighter_than_the_unknown_grey(tmp_path: Path):
    """As with a free_thresh of 0.196, of which the greys below 205 are not free."""
    cells, _ = read(saved(tmp_path, with_stray(room(), 192, 200, 204, 205, 206, 230), **LOOSE))
    assert cells[0, :6].tolist() == [UNKNOWN] * 4 + [FREE] * 2


def test_the_warning_names_the_grey_as_the_image_has_it(tmp_path: Path):
    _, (said,) = read(saved(tmp_path, room(), **LOOSE))
    count = int((room() == UNKNOWN).sum())
    assert f"free_thresh 0.25 makes grey 205, unknown in a trinary map, free; its {count:,} cells" in said
    _, (said,) = read(saved(tmp_path, 255 - room(), negate=1, **LOOSE))
    assert "makes grey 50, unknown" in said
    _, (said,) = read(saved(tmp_path, with_alpha(room())))
    assert f"{count:,} more cells are read as unknown, 0 fewer (as map_server" in said


@pytest.mark.parametrize(
    ("pixels", "fields"),
    [
        (np.array([[0, 100, 205, 254]], np.uint8), LOOSE),
        (np.tile(np.arange(256, dtype=np.uint8), (40, 1)), LOOSE),
        (np.clip(RNG.normal(205.0, 25.0, (90, 90)), 0, 255).astype(np.uint8), LOOSE),
        (grey_of(0, 89, 178), {"free_thresh": 0.48, "occupied_thresh": 0.83}),
        (grey_of(0, 127, 255), {}),
        (grey_of(0, 127, 205), LOOSE),
    ],
    ids=["four greys", "ramp", "grey scale", "RTAB-Map's", "127 and 255", "205 is free"],
)
def test_what_is_no_trinary_map_or_has_the_right_thresholds_keeps_to_them(
    tmp_path: Path, pixels: np.ndarray, fields: dict
):
    path = saved(tmp_path, pixels, **fields)
    cells, said = read(path)
    np.testing.assert_array_equal(cells, read(path, strict=True)[0])
    assert not said


def test_what_is_fully_transparent_is_unknown_unless_strict(tmp_path: Path):
    for grey in (0, 255):  # as erasers leave it
        pixels = with_alpha(room())
        pixels[:10] = (grey, grey, grey, 0)
        cells, said = read(saved(tmp_path, pixels))
        np.testing.assert_array_equal(cells, room())
        assert "more cells are read as unknown, 0 fewer" in said[0]
        strictly, _ = read(tmp_path / "map.yaml", strict=True)
        assert set(np.unique(strictly[:10])) == {OCCUPIED if grey == 0 else UNKNOWN}


def test_transparency_of_mode_scale_leaves_the_greys_to_the_thresholds(tmp_path: Path):
    pixels = with_alpha(room())
    pixels[:40, :, 3] = 0
    cells, said = read(saved(tmp_path, pixels, mode="scale", **LOOSE))
    assert (cells[:40] == UNKNOWN).all()
    assert (cells[50:] == FREE).all()
    assert not said


@pytest.mark.parametrize(
    ("levels", "negate", "said"),
    [
        (
            (0, 89, 178),
            0,
            r"greys is free by free_thresh 0\.196: 0 \(2\.8%\), 89 \(75\.0%\), 178 \(22\.2%\); .* as RTAB-"
            r"Map draws them, write occupied_thresh: 0\.83 and free_thresh: 0\.48; --strict reads it as "
            r"is",
        ),
        ((255, 166, 77), 1, r"255 \(.*\), 166 \(.*\), 77 .*occupied_thresh: 0\.83 and free_thresh: 0\.48"),
        ((0, 50, 100), 0, r"if they are per cent, write mode: raw"),
        ((0, 128, 200), 0, r"write occupied_thresh: 0\.75 and free_thresh: 0\.36"),
    ],
)
def test_greys_of_another_scale_are_told_with_the_thresholds_that_fit(
    tmp_path: Path, levels: tuple[int, ...], negate: int, said: str
):
    path = saved(tmp_path, grey_of(*levels), negate=negate)
    with pytest.raises(MapError, match=rf"\A[^\n]*map\.yaml: none of its .*{said}[^\n]*\Z"):
        read_ros_map(path, strict=False)
    assert not (read(path, strict=True)[0] == FREE).any()


def test_the_thresholds_that_are_told_are_right(tmp_path: Path):
    path = saved(tmp_path, grey_of(0, 89, 178), occupied_thresh=0.83, free_thresh=0.48)
    np.testing.assert_array_equal(read(path)[0], room())


def test_unknown_cells_that_are_read_as_walls_are_told(tmp_path: Path):
    _, (said,) = read(saved(tmp_path, grey_of(0, 89, 178), free_thresh=0.48))
    assert "grey 89 is occupied by occupied_thresh 0.65: 0 (2.8%), 89 (75.0%), 178 (22.2%)" in said
    assert "if it is unknown, write occupied_thresh: 0.83 and free_thresh: 0.48" in said


def test_eight_bits_saved_as_sixteen_are_told(tmp_path: Path):
    path = saved(tmp_path, room().astype(np.uint16))
    with pytest.raises(MapError, match="has 65,535 for white, and nothing above 254: 8 bits saved as 16"):
        read_ros_map(path, strict=False)
    assert (read(path, strict=True)[0] == OCCUPIED).all()


def test_a_negated_map_with_an_opaque_alpha_channel_is_read_by_its_grey(tmp_path: Path):
    cells, (said,) = read(saved(tmp_path, with_alpha(255 - room()), negate=1))
    np.testing.assert_array_equal(cells, room())
    assert "0 more cells are read as unknown, 1,064 fewer" in said


@pytest.mark.parametrize(("alpha", "cell"), [(127, UNKNOWN), (128, FREE)])
def test_what_is_less_than_half_opaque_is_transparent(tmp_path: Path, alpha: int, cell: int):
    pixels = with_alpha(room())
    pixels[20, 30, 3] = alpha
    assert read(saved(tmp_path, pixels))[0][20, 30] == cell


@pytest.mark.parametrize("unknown", [127, 128, UNKNOWN])
def test_a_map_of_walls_and_unknown_cells_alone_is_read(tmp_path: Path, unknown: int):
    cells, said = read(saved(tmp_path, grey_of(0, unknown, unknown)))
    assert set(np.unique(cells)) == {OCCUPIED, UNKNOWN}
    assert not said
    with pytest.raises(MapError, match=r"0 \(2\.8%\), 150 .* if they are occupied and free"):
        read(saved(tmp_path, grey_of(0, 150, 150)))
