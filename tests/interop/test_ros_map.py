from __future__ import annotations

import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from rendezvous.errors import MapError
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2
from rendezvous.interop.ros_map import read_ros_map, write_ros_map

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


@given(
    st.integers(0, 999),
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    st.floats(1e-6, 1e3),
    st.builds(SE2, st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), st.floats(-3.1, 3.1)),
)
def test_any_map_comes_back_as_it_was_written(tmp_path_factory, seed, shape, resolution_m, T_m_g):
    cells = np.random.default_rng(seed).choice(np.array([OCCUPIED, UNKNOWN, FREE], np.uint8), shape)
    grid = OccupancyGrid(cells=cells, resolution_m=resolution_m, T_m_g=T_m_g)
    path = tmp_path_factory.mktemp("map") / "map.yaml"
    write_ros_map(grid, path)
    assert _same(read_ros_map(path, strict=True), grid)


def _image_map(tmp_path, pixels: np.ndarray, *, suffix: str = ".png", **fields: object) -> Path:
    """A map whose image is these pixels, top row first."""
    (tmp_path / f"map{suffix}").write_bytes(cv2.imencode(suffix, pixels)[1].tobytes())
    keys = {"image": f"map{suffix}", "resolution": 0.05, "origin": [0, 0, 0], **fields}
    path = tmp_path / "map.yaml"
    path.write_text("".join(f"{key}: {value}\n" for key, value in keys.items()))
    return path


def _map_server(shade: float, mode: str, *, negate: bool, opaque: bool = True) -> int:
    """nav2's rule for a pixel of brightness 0 to 1, in words: what it publishes, reduced to three values."""
    p = shade if negate else 1.0 - shade
    if mode == "raw":
        percent = round(255 * shade)
        published = percent if percent <= 100 else -1
        return UNKNOWN if published < 0 else _trinary(published / 100)
    return UNKNOWN if mode == "scale" and not opaque else _trinary(p)


def _trinary(p: float) -> int:
    return OCCUPIED if p > 0.65 else FREE if p < 0.196 else UNKNOWN


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("negate", [0, 1])
@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
def test_every_grey_is_read_as_map_server_reads_it(tmp_path, mode, negate, dtype):
    white = np.iinfo(dtype).max
    greys = np.unique(np.linspace(0, white, 256).astype(dtype))
    path = _image_map(tmp_path, greys[None], mode=mode, negate=negate)
    expected = [_map_server(int(grey) / white, mode, negate=bool(negate)) for grey in greys]
    assert read_ros_map(path, strict=True).cells[0].tolist() == expected


def test_transparent_pixels_are_averaged_in_by_trinary_and_unknown_to_scale(tmp_path):
    # Opaque and transparent black, opaque, half and fully transparent white.
    grey_alpha = [(0, 255), (0, 0), (255, 255), (255, 128), (255, 0)]
    pixels = np.array([[(grey, grey, grey, alpha) for grey, alpha in grey_alpha]], np.uint8)
    shades = [(3 * grey + alpha) / 1020 for grey, alpha in grey_alpha]
    trinary = read_ros_map(_image_map(tmp_path, pixels), strict=True).cells[0].tolist()
    assert trinary == [_map_server(shade, "trinary", negate=False) for shade in shades]
    assert trinary == [OCCUPIED, OCCUPIED, FREE, FREE, UNKNOWN]
    scale = read_ros_map(_image_map(tmp_path, pixels, mode="scale"), strict=True).cells[0].tolist()
    assert scale == [OCCUPIED, UNKNOWN, FREE, UNKNOWN, UNKNOWN]


@pytest.mark.parametrize(
    ("suffix", "channels"), [(".png", 1), (".png", 3), (".bmp", 1), (".bmp", 3), (".pgm", 1)]
)
def test_images_of_all_formats_are_read(tmp_path, suffix, channels):
    pixels = GRID.cells[::-1] if channels == 1 else np.dstack([GRID.cells[::-1]] * 3)
    path = _image_map(tmp_path, pixels, suffix=suffix, origin=[-3.25, 1.5, 0.3])
    assert _same(read_ros_map(path, strict=False), GRID)


def test_an_image_may_lie_elsewhere_and_nav2_may_say_more(tmp_path):
    write_ros_map(GRID, tmp_path / "map.yaml")
    (tmp_path / "images").mkdir()
    (tmp_path / "map.pgm").rename(tmp_path / "images" / "map.pgm")
    text = (tmp_path / "map.yaml").read_text() + "frame_id: map\nmap_load_time: 0\n"
    for image in ("images/map.pgm", tmp_path / "images" / "map.pgm"):
        (tmp_path / "map.yaml").write_text(text.replace("image: map.pgm", f"image: {image}"))
        assert _same(read_ros_map(tmp_path / "map.yaml", strict=False), GRID)


def _altered(tmp_path, old: str, new: str):
    path = tmp_path / "map.yaml"
    write_ros_map(GRID, path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("mode: trinary", "mode: Trinary"),
        ("mode: trinary", "mode:"),
        ("mode: trinary\n", ""),
        ("negate: 0", 'negate: "0"'),
        ("negate: 0", "negate: false"),
        ("negate: 0", "negate: 0.0"),
        ("resolution: 0.05", 'resolution: "0.05"'),
        ("image: map.pgm", 'image: "map.pgm"'),
        ("origin: [-3.25, 1.5, 0.3]", 'origin: ["-3.25", "1.5", "0.3"]'),
    ],
)
def test_what_is_spelt_otherwise_is_read_as_meant(tmp_path, old, new):
    assert _same(read_ros_map(_altered(tmp_path, old, new), strict=False), GRID)


@pytest.mark.parametrize("negate", ["1", '"1"', "true", '"True"', "1.0", "yes", "'Y'", "'on'"])
def test_negate_may_be_spelt_in_many_ways(tmp_path, negate):
    path = _altered(tmp_path, "negate: 0", f"negate: {negate}")
    (tmp_path / "map.pgm").write_bytes(b"P5\n11 7\n255\n" + (255 - GRID.cells)[::-1].tobytes())
    assert _same(read_ros_map(path, strict=False), GRID)


@pytest.mark.parametrize(
    "name", ["a map.png", "map #2.png", "a: b.png", "- x.png", "käfer.png", "'.png", "\udcff.png"]
)
def test_any_name_of_an_image_is_written_so_that_it_is_read(tmp_path, name):
    path = (tmp_path / name).with_suffix(".yaml")
    write_ros_map(GRID, path)
    assert _same(read_ros_map(path, strict=False), GRID)


def test_numbers_of_numpy_are_written_as_numbers(tmp_path):
    grid = OccupancyGrid(
        cells=GRID.cells,
        resolution_m=np.float64(0.05),
        T_m_g=SE2(np.float64(-3.25), np.float64(1.5), np.float64(0.3)),
    )
    write_ros_map(grid, tmp_path / "map.yaml")
    fields = yaml.safe_load((tmp_path / "map.yaml").read_text())
    assert (fields["resolution"], fields["origin"]) == (0.05, [-3.25, 1.5, 0.3])


def test_a_grey_exactly_on_a_threshold_is_unknown(tmp_path):
    # 51 and 204 of 255 are p = 0.8 and p = 0.2 without a remainder.
    pixels = np.array([[50, 51, 52, 203, 204, 205]], np.uint8)
    path = _image_map(tmp_path, pixels, occupied_thresh=0.8, free_thresh=0.2)
    expected = [OCCUPIED, UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN, FREE]
    assert read_ros_map(path, strict=True).cells[0].tolist() == expected


def test_between_equal_thresholds_nothing_is_unknown_but_what_lies_on_them(tmp_path):
    pixels = np.array([[0, 127, 128, 255]], np.uint8)
    path = _image_map(tmp_path, pixels, occupied_thresh=0.5, free_thresh=0.5)
    assert read_ros_map(path, strict=True).cells[0].tolist() == [OCCUPIED, OCCUPIED, FREE, FREE]
    on_it = _image_map(tmp_path, pixels[:, :1] + np.uint8(51), occupied_thresh=0.8, free_thresh=0.8)
    assert read_ros_map(on_it, strict=True).cells.tolist() == [[UNKNOWN]]


def test_a_negated_map_is_read_the_other_way_round(tmp_path):
    path = _altered(tmp_path, "negate: 0", "negate: 1")
    inverted = 255 - GRID.cells
    (tmp_path / "map.pgm").write_bytes(b"P5\n11 7\n255\n" + inverted[::-1].tobytes())
    assert _same(read_ros_map(path, strict=False), GRID)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("resolution: 0.05", "resolution: fine", "resolution is 'fine'; must be metres above 0"),
        ("resolution: 0.05", "resolution: .nan", "resolution is nan; must be metres above 0"),
        ("resolution: 0.05", "resolution: 0", "resolution is 0; must be metres above 0"),
        ("resolution: 0.05", "resolution: -0.05", r"resolution is -0\.05; must be metres above 0"),
        ("resolution: 0.05", "resolution: true", "resolution is True; must be metres above 0"),
        ("resolution: 0.05", f"resolution: {10**400}", r"resolution is 1000\d*\.\.\.\d*000; must be metres"),
        ("resolution: 0.05\n", "", "no key 'resolution'; must be a ROS map's image, resolution and origin"),
        ("origin: [-3.25, 1.5, 0.3]", "origin: [0, 0]", r"origin is \[0, 0\]; must be \[x, y, yaw\]"),
        ("origin: [-3.25, 1.5, 0.3]", "origin: [0, .inf, 0]", r"origin is \[0, inf, 0\]; must be \[x"),
        ("origin: [-3.25, 1.5, 0.3]", "origin: 3", r"origin is 3; must be \[x, y, yaw\]"),
        ("mode: trinary", "mode: row", "mode is 'row'; must be one of trinary, scale, raw"),
        ("mode: trinary", "mode: [raw]", r"mode is \['raw'\]; must be one of"),
        (
            "image: map.pgm",
            "image: other.pgm",
            r"other\.pgm: image cannot be read \(No such file or dir.*PNG",
        ),
        (
            "image: map.pgm",
            "image: .",
            r": image cannot be read \(Is a directory\); must be PGM, PNG, BMP or JPEG",
        ),
        (
            "image: map.pgm",
            "image: map.yaml",
            r"map\.yaml: \d+ bytes that are no PGM \(P2, P5\), PNG, BMP or JPEG",
        ),
        ("image: map.pgm", "image: /dev/zero", r"image cannot be read \(Is no regular file\); must be PGM"),
        ("image: map.pgm", 'image: "a\\0b"', "no file's name holds a zero byte"),
        (
            "image: map.pgm",
            f"image: [{'[a, a, a, a], ' * 9}]",
            r"image is .{99,103} \.\.\.; must be the path",
        ),
        ("image: map.pgm", "image: 7", "image is 7; must be the path"),
        ("image: map.pgm", "image: ''", "image is ''; must be the path"),
        ("image: map.pgm\n", "", "no key 'image'"),
        ("negate: 0", "negate: [", "cannot be read as YAML"),
        ("negate: 0", "negate: 2", "negate is 2; must be 0 or 1"),
        ("occupied_thresh: 0.65", "occupied_thresh: 65", "occupied_thresh is 65; must be a probability"),
        (
            "free_thresh: 0.196",
            "free_thresh: -0.1",
            r"free_thresh is -0\.1; must be a probability from 0 to 1",
        ),
        ("free_thresh: 0.196", "free_thresh: .nan", "free_thresh is nan; must be a probability"),
        ("free_thresh: 0.196", "free_thresh: 0.66", r"free_thresh 0\.66 is above occupied_thresh 0\.65"),
        ("free_thresh: 0.196", "free_thresh: &a [*a]", r"free_thresh\[0\]: \*a is part of what"),
    ],
)
def test_a_faulty_map_is_named_with_its_fault(tmp_path, old, new, message):
    with pytest.raises(MapError, match=rf"\A.*{message}.*\Z"):
        read_ros_map(_altered(tmp_path, old, new), strict=False)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "holds no keys"),
        (b"- 1\n- 2\n", "holds no keys"),
        (b"[" * 600, "cannot be read as YAML"),
        (b"image: a\n- b", "cannot be read as YAML"),
    ],
)
def test_a_file_that_is_no_yaml_is_named(tmp_path, data, message):
    path = tmp_path / "map.yaml"
    path.write_bytes(data)
    with pytest.raises(MapError, match=rf"\A.*map\.yaml: {message}.*\Z"):
        read_ros_map(path, strict=False)


@pytest.mark.parametrize(("name", "reason"), [("nowhere.yaml", "No such file"), ("", "Is a directory")])
def test_a_missing_map_and_a_folder_are_named(tmp_path, name, reason):
    with pytest.raises(MapError, match=rf"{tmp_path.name}.*: cannot be read as YAML \(.*{reason}"):
        read_ros_map(tmp_path / name, strict=False)


def test_an_origin_that_looks_like_degrees_is_read_with_a_warning(tmp_path):
    path = _altered(tmp_path, "origin: [-3.25, 1.5, 0.3]", "origin: [-3.25, 1.5, 90]")
    with pytest.warns(UserWarning, match=r"yaw of 90 rad, .*90° are 1\.5708 rad"):
        assert read_ros_map(path, strict=False).T_m_g.yaw_rad == 90.0


@pytest.mark.parametrize(("yaw_rad", "told"), [(6.28, False), (-6.28, False), (6.29, True), (-6.29, True)])
def test_a_yaw_of_less_than_a_turn_is_no_degrees(tmp_path, yaw_rad, told, recwarn):
    path = _altered(tmp_path, "origin: [-3.25, 1.5, 0.3]", f"origin: [-3.25, 1.5, {yaw_rad}]")
    assert read_ros_map(path, strict=False).T_m_g.yaw_rad == yaw_rad
    assert bool(recwarn.list) is told


@pytest.mark.parametrize("name", ["map1", "map2"])
def test_a_real_map_survives_reading_and_writing(real_data, tmp_path, name):
    grid = read_ros_map(real_data / "real_pair" / f"{name}.yaml", strict=True)
    assert set(np.unique(grid.cells)) == {OCCUPIED, UNKNOWN, FREE}
    write_ros_map(grid, tmp_path / "map.yaml")
    assert _same(read_ros_map(tmp_path / "map.yaml", strict=True), grid)


@pytest.mark.parametrize(
    "changed",
    [
        lambda text: text.encode("utf-16"),
        lambda text: b"\xef\xbb\xbf" + text.encode(),
        lambda text: text.replace(": ", ":\t").replace("\n", "\t\r\n").encode(),
        lambda text: text.encode() + b"# f\xfcr 5\xb0\n",
        lambda text: text.encode() + b"made: 2024-13-41\nby: !robot {name: a}\nof: !robot [1]\n",
        lambda text: text.replace("resolution: ", "resolution: !metres ").encode(),
    ],
    ids=["UTF-16", "BOM", "tabs", "Latin-1", "dates and tags", "a tag"],
)
def test_what_yaml_cpp_reads_is_read(tmp_path, changed):
    write_ros_map(GRID, tmp_path / "map.yaml")
    text = (tmp_path / "map.yaml").read_text()
    (tmp_path / "map.yaml").write_bytes(changed(text))
    assert _same(read_ros_map(tmp_path / "map.yaml", strict=False), GRID)
