from __future__ import annotations

import warnings

import cv2
import numpy as np
import pytest

from pipeline.errors import MapError
from pipeline.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from pipeline.geometry.se2 import SE2
from pipeline.interop.ros_map import read_ros_map, write_ros_map

GRID = OccupancyGrid(
    cells=np.random.default_rng(0).choice(np.array([OCCUPIED, UNKNOWN, FREE], np.uint8), (7, 11)),
    resolution_m=0.05,
    T_m_g=SE2(-3.25, 1.5, 0.3),
)


def _same(a: OccupancyGrid, b: OccupancyGrid) -> bool:
    return np.array_equal(a.cells, b.cells) and (a.resolution_m, a.T_m_g) == (b.resolution_m, b.T_m_g)


@pytest.mark.parametrize("strict", [False, True])
def test_a_map_comes_back_as_it_was_written(tmp_path, strict):
    write_ros_map(GRID, tmp_path / "map.yaml")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert _same(read_ros_map(tmp_path / "map.yaml", strict=strict), GRID)


def test_the_image_is_one_that_others_read_with_north_up(tmp_path):
    image = cv2.imread(str(write_ros_map(GRID, tmp_path / "map.yaml")), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(image[::-1], GRID.cells)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["map.pgm", "map.yaml"]


def _altered(tmp_path, old: str, new: str):
    path = tmp_path / "map.yaml"
    write_ros_map(GRID, path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


def test_unknown_cells_survive_the_thresholds_that_nav2_once_wrote(tmp_path):
    path = _altered(tmp_path, "free_thresh: 0.196", "free_thresh: 0.25")
    with pytest.warns(UserWarning, match=r"free_thresh 0\.25 makes grey 205, unknown in a trinary map, free"):
        assert _same(read_ros_map(path, strict=False), GRID)
    strictly = read_ros_map(path, strict=True)
    assert np.array_equal(strictly.free(), GRID.cells != OCCUPIED)


def test_a_negated_map_is_read_the_other_way_round(tmp_path):
    path = _altered(tmp_path, "negate: 0", "negate: 1")
    inverted = 255 - GRID.cells
    (tmp_path / "map.pgm").write_bytes(b"P5\n11 7\n255\n" + inverted[::-1].tobytes())
    assert _same(read_ros_map(path, strict=False), GRID)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("resolution: 0.05", "resolution: fine", "resolution is 'fine'; must be a number"),
        ("resolution: 0.05\n", "", "no key 'resolution'"),
        ("origin: [-3.25, 1.5, 0.3]", "origin: [0, 0]", r"origin is \[0, 0\]; must be \[x, y, yaw\]"),
        ("mode: trinary", "mode: raw", "mode is 'raw'; only trinary"),
        ("image: map.pgm", "image: other.pgm", r"image .*other\.pgm is missing"),
        ("negate: 0", "negate: [", "cannot be read as YAML"),
    ],
)
def test_a_faulty_map_is_named_with_its_fault(tmp_path, old, new, message):
    with pytest.raises(MapError, match=message):
        read_ros_map(_altered(tmp_path, old, new), strict=False)


def test_a_missing_map_is_named(tmp_path):
    with pytest.raises(MapError, match=r"nowhere\.yaml: cannot be read"):
        read_ros_map(tmp_path / "nowhere.yaml", strict=False)


@pytest.mark.parametrize("name", ["map1", "map2"])
def test_a_real_map_survives_reading_and_writing(real_data, tmp_path, name):
    grid = read_ros_map(real_data / "real_pair" / f"{name}.yaml", strict=True)
    assert set(np.unique(grid.cells)) == {OCCUPIED, UNKNOWN, FREE}
    write_ros_map(grid, tmp_path / "map.yaml")
    assert _same(read_ros_map(tmp_path / "map.yaml", strict=True), grid)
