"""Files of real users that were read wrongly or refused, where they are at hand."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest

from rendezvous.errors import FloorplanError, MapError
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN
from rendezvous.interop.camera_info import read_camera_info
from rendezvous.interop.houseexpo_files import parsed_json, plan_files
from rendezvous.interop.ros_map import read_ros_map

CELLS = {0: (1115, 11452, 10383), 1: (1140, 14764, 9527)}
"""Occupied, unknown and free cells of both maps of the shipped sighting."""


@pytest.fixture(scope="module")
def faults(real_data: Path) -> Path:
    folder = real_data / "faults"
    if not folder.is_dir():
        pytest.skip(f"no {folder}")
    return folder


def counts(path: Path) -> tuple[tuple[int, ...], list[str]]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        cells = read_ros_map(path, strict=False).cells
    found = tuple(int((cells == value).sum()) for value in (OCCUPIED, UNKNOWN, FREE))
    return found, [str(warning.message) for warning in caught]


@pytest.mark.parametrize(
    ("name", "said"),
    [("crlf", ""), ("modecap", ""), ("quoted", ""), ("rgba", "more cells are read as unknown")],
)
@pytest.mark.parametrize("number", [0, 1])
def test_a_map_of_the_shipped_sighting_has_its_cells(faults: Path, name: str, number: int, said: str):
    found, warned = counts(faults / f"{name}{number}.yaml")
    assert found == CELLS[number]
    assert [said in text for text in warned] == [True] * bool(said)


@pytest.mark.parametrize("name", ["onepix0", "real_edit1", "real_edit2"])
def test_unknown_cells_stay_unknown_whatever_else_was_drawn(faults: Path, tmp_path: Path, name: str):
    path = faults / f"{name}.yaml"
    (tmp_path / f"{name}.pgm").symlink_to(faults.resolve() / f"{name}.pgm")
    (tmp_path / "map.yaml").write_text(path.read_text().replace("free_thresh: 0.25", "free_thresh: 0.196"))
    found, (said,) = counts(path)
    assert found == counts(tmp_path / "map.yaml")[0]
    assert "read as unknown" in said


@pytest.mark.parametrize("number", [0, 1])
def test_equal_thresholds_part_the_greys(faults: Path, number: int):
    occupied, unknown, free = CELLS[number]
    assert counts(faults / f"pcd{number}.yaml") == ((occupied, 0, unknown + free), [])


@pytest.mark.parametrize("number", [0, 1])
def test_the_greys_of_rtab_map_are_told(faults: Path, number: int):
    with pytest.raises(
        MapError, match=r"0 \(.*\), 89 \(.*\), 178 .*occupied_thresh: 0\.83 and free_thresh: 0\.48"
    ):
        read_ros_map(faults / f"rtab{number}.yaml", strict=False)


@pytest.mark.parametrize(
    ("name", "count"), [("equi5", 4), ("cam/rp14", 14), ("cam/pb8zero", 5), ("cam/roi_full", 5)]
)
def test_a_camera_is_read_with_as_many_coefficients_as_its_model_has(faults: Path, name: str, count: int):
    assert len(read_camera_info(faults / f"{name}.yaml").distortion) == count


def test_plans_with_text_that_is_not_unicode_are_faults(faults: Path):
    (file,) = plan_files(str(faults / "plans_surrogate"))
    with pytest.raises(FloorplanError, match="half a character"):
        parsed_json(file.content, file.source)
    found = list(plan_files(str(faults / "plans_tar" / "gnu.tar.gz")))
    assert [file.fault for file in found] == ["its name is not UTF-8; rename it", ""]
