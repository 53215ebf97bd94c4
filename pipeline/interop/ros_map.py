"""Maps of ROS: an image of the occupancy grid and a YAML file beside it (`map_server`, `map_saver`)."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from pipeline.errors import MapError
from pipeline.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, Cells, OccupancyGrid
from pipeline.geometry.se2 import SE2

OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
"""With these, grey 205 (probability 0.1961) loads as unknown; a free_thresh of 0.25 would make it free."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Header:
    """What the YAML file says."""

    image: str
    resolution_m: float
    T_m_g: SE2
    negate: bool
    occupied_thresh: float
    free_thresh: float


def write_ros_map(grid: OccupancyGrid, yaml_path: Path) -> Path:
    """Writes a grid as a PGM and a YAML that ROS 1 and ROS 2 load as it is.

    Args:
        grid: the map.
        yaml_path: the YAML file; the image is written beside it with the suffix `.pgm`.

    Returns:
        The image's path.
    """
    image_path = yaml_path.with_suffix(".pgm")
    height, width = grid.cells.shape
    image_path.write_bytes(f"P5\n{width} {height}\n255\n".encode() + grid.cells[::-1].tobytes())
    x_m, y_m, yaw_rad = (float(value) for value in grid.T_m_g.wrapped().as_array())
    yaml_path.write_text(
        f"image: {image_path.name}\nmode: trinary\nresolution: {grid.resolution_m!r}\n"
        f"origin: [{x_m!r}, {y_m!r}, {yaw_rad!r}]\nnegate: 0\n"
        f"occupied_thresh: {OCCUPIED_THRESH}\nfree_thresh: {FREE_THRESH}\n"
    )
    return image_path


def read_ros_map(yaml_path: Path, *, strict: bool) -> OccupancyGrid:
    """Reads a map of ROS as a trinary grid.

    Some versions of nav2 saved `free_thresh: 0.25`, with which the unknown cells (205) of their own trinary
    files load as free. Such cells are read as unknown, with a warning.

    Args:
        yaml_path: the YAML file.
        strict: keep to the thresholds as they are written, also there.

    Raises:
        MapError: a file is missing or no map, or a key is missing or wrong; says which.
    """
    header = _header(yaml_path)
    image_path = yaml_path.parent / header.image
    image = cv2.imread(str(image_path), cv2.IMREAD_GRAYSCALE) if image_path.is_file() else None
    if image is None:
        raise MapError(
            f"{yaml_path}: image {image_path} is missing or cannot be read; must be PGM, PNG or BMP"
        )
    cells = _trinary(np.asarray(image, np.uint8), header, strict=strict, source=yaml_path)
    return OccupancyGrid(
        cells=np.ascontiguousarray(cells[::-1]), resolution_m=header.resolution_m, T_m_g=header.T_m_g
    )


def _trinary(image: Cells, header: _Header, *, strict: bool, source: Path) -> Cells:
    """map_server's trinary mode: probability by darkness, then two thresholds."""
    darkness = image if header.negate else 255 - image
    probability = darkness / 255.0
    free = probability < header.free_thresh
    unknown_grey = 255 - UNKNOWN if header.negate else UNKNOWN
    if (
        not strict
        and set(np.unique(image)) <= {0, unknown_grey, 254, 255}
        and free[image == unknown_grey].any()
    ):
        warnings.warn(
            f"{source}: free_thresh {header.free_thresh} makes grey {unknown_grey}, unknown in a trinary "
            "map, free; read as unknown",
            stacklevel=3,
        )
        free &= image != unknown_grey
    cells = np.full(image.shape, UNKNOWN, np.uint8)
    cells[free] = FREE
    cells[probability > header.occupied_thresh] = OCCUPIED
    return cells


def _header(path: Path) -> _Header:
    try:
        fields = yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise MapError(f"{path}: cannot be read as YAML ({' '.join(str(error).split())})") from error
    if not isinstance(fields, dict):
        raise MapError(f"{path}: holds no keys; a ROS map has image, resolution and origin")
    if fields.get("mode", "trinary") != "trinary":
        raise MapError(
            f"{path}: mode is {fields['mode']!r}; only trinary maps have occupied, free and unknown"
        )
    return _Header(
        image=str(_required(fields, "image", path)),
        resolution_m=_number(fields, "resolution", path),
        T_m_g=_origin(fields, path),
        negate=bool(fields.get("negate", 0)),
        occupied_thresh=_number(fields, "occupied_thresh", path, default=OCCUPIED_THRESH),
        free_thresh=_number(fields, "free_thresh", path, default=FREE_THRESH),
    )


def _required(fields: dict[str, Any], key: str, path: Path) -> Any:
    if key not in fields:
        raise MapError(f"{path}: no key {key!r}; a ROS map has image, resolution and origin")
    return fields[key]


def _number(fields: dict[str, Any], key: str, path: Path, *, default: float | None = None) -> float:
    value = fields.get(key, default) if default is not None else _required(fields, key, path)
    if not _is_number(value):
        raise MapError(f"{path}: {key} is {value!r}; must be a number")
    return float(value)


def _origin(fields: dict[str, Any], path: Path) -> SE2:
    origin = _required(fields, "origin", path)
    if not (isinstance(origin, list) and len(origin) == 3 and all(_is_number(value) for value in origin)):
        raise MapError(f"{path}: origin is {origin!r}; must be [x, y, yaw] in metres and radians")
    return SE2.from_array(origin)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
