"""Maps of ROS: an image of the occupancy grid and a YAML file beside it (`map_server`, `map_saver`).

How dark a pixel is says how likely its cell is occupied: `p = 1 - grey / white`, or `grey / white` if
`negate` is set. Above `occupied_thresh` a cell is occupied, else below `free_thresh` free, else unknown. The
modes are those of nav2's map_server (ROS 1 differs only where noted):

- `trinary`: just that. Transparency is averaged into the grey value as if it were a colour, in ROS 1 as in
  nav2: fully transparent black is `p = 1`, occupied, transparent white `p = 0.25`, unknown.
- `scale`: map_server grades what lies between the thresholds; here that is unknown, as this project's grids
  have three values. A pixel that is not fully opaque is unknown (ROS 1: a fully transparent one between the
  thresholds).
- `raw`: the grey value itself (0 to 255) is the occupancy in per cent, `p = grey / 100`; above 100 it is
  unknown. The same thresholds reduce it to three values. `negate` does nothing (it does in ROS 1), nor does
  transparency.

Unless it is asked to be strict, `read_ros_map` departs from this where it turns unknown cells into free or
occupied ones: see `map_greys`. A transparent pixel is unknown then, and an opaque one has its grey value.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from rendezvous.errors import MapError
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, Cells, OccupancyGrid
from rendezvous.geometry.se2 import SE2
from rendezvous.interop.map_greys import Thresholds, keep_meaning
from rendezvous.interop.map_image import MapImage, read_map_image
from rendezvous.interop.yaml_fields import number, numbers, read_yaml_fields, short

OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
"""With these, grey 205 (probability 0.1961) loads as unknown; a free_thresh of 0.25 would make it free."""

MODES = ("trinary", "scale", "raw")
KEYS = "a ROS map's image, resolution and origin"
_NEGATE = dict.fromkeys(("0", "0.0", "false", "no", "n", "off"), False)
_NEGATE |= dict.fromkeys(("1", "1.0", "true", "yes", "y", "on"), True)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Header:
    """The YAML file's values."""

    image: str
    mode: str
    resolution_m: float
    T_m_g: SE2
    negate: bool
    occupied_thresh: float
    free_thresh: float


def write_ros_map(grid: OccupancyGrid, yaml_path: Path) -> Path:
    """Write a grid as a PGM and a YAML file that ROS 1 and ROS 2 load.

    Args:
        grid: the map.
        yaml_path: the YAML file; the image is written beside it with the suffix `.pgm`.

    Returns:
        The image's path.
    """
    image_path = yaml_path.with_suffix(".pgm")
    image, header = ros_map_bytes(grid, image_path.name)
    image_path.write_bytes(image)
    yaml_path.write_bytes(header)
    return image_path


def ros_map_bytes(grid: OccupancyGrid, image_name: str) -> tuple[bytes, bytes]:
    """The PGM of a grid, and the YAML that names it `image_name`."""
    height, width = grid.cells.shape
    fields = {
        "image": image_name,
        "mode": "trinary",
        "resolution": float(grid.resolution_m),
        "origin": [float(value) for value in grid.T_m_g.wrapped().as_array()],
        "negate": 0,
        "occupied_thresh": OCCUPIED_THRESH,
        "free_thresh": FREE_THRESH,
    }
    header = yaml.safe_dump(
        fields, sort_keys=False, default_flow_style=None, allow_unicode=True, width=math.inf
    )
    return f"P5\n{width} {height}\n255\n".encode() + grid.cells[::-1].tobytes(), header.encode()


def read_ros_map(yaml_path: Path, *, strict: bool) -> OccupancyGrid:
    """Read a map of ROS, of any mode, as a trinary grid.

    Args:
        yaml_path: the YAML file; `image` in it is absolute or relative to its folder.
        strict: keep to map_server's rule also where it makes unknown cells free or occupied.

    Raises:
        MapError: a file is missing or is no map, or a key is missing or wrong; or, unless strict, the greys
            are of another scale than the thresholds.

    Warns:
        UserWarning: the map can be read, but something in it is probably not what was meant.
    """
    header = _header(yaml_path)
    image = read_map_image(yaml_path.parent / header.image)
    if strict or header.mode == "raw":
        cells = _as_map_server_reads(image, header)
    else:
        cells = _as_meant(image, header, yaml_path)
    return OccupancyGrid(
        cells=np.ascontiguousarray(cells[::-1]), resolution_m=header.resolution_m, T_m_g=header.T_m_g
    )


def map_image_path(yaml_path: Path) -> Path:
    """Path of the image that the YAML file of a ROS map names.

    Raises:
        MapError: the file is missing or is no YAML, or names no image.
    """
    return yaml_path.parent / _image_name(read_yaml_fields(yaml_path, MapError, right=KEYS), yaml_path)


def _as_map_server_reads(image: MapImage, header: _Header) -> Cells:
    """(H, W) uint8, top row first."""
    shades, white = image.grey, image.white
    if header.mode == "trinary" and image.alpha is not None:
        shades, white = image.grey.astype(np.uint32) * 3 + image.alpha, 4 * white
    shade = np.arange(white + 1)
    if header.mode == "raw":
        percent = np.round(255.0 * shade / white)
        probability = np.where(percent <= 100.0, percent / 100.0, np.nan)
    else:
        probability = (shade if header.negate else white - shade) / white
    values = np.full(white + 1, UNKNOWN, np.uint8)
    values[probability < header.free_thresh] = FREE
    values[probability > header.occupied_thresh] = OCCUPIED
    cells: Cells = values[shades]
    if header.mode == "scale" and image.alpha is not None:
        cells[image.alpha < image.white] = UNKNOWN
    return cells


def _as_meant(image: MapImage, header: _Header, source: Path) -> Cells:
    """As map_server reads it, but for what that makes of transparency and of unknown cells."""
    if image.white > 255 >= image.grey.max() > 0:
        raise MapError(
            f"{source}: its image has {image.white:,} for white, and nothing above {image.grey.max()}: 8 "
            "bits saved as 16; save it with 8, or use --strict to read it as it is"
        )
    cells = _as_map_server_reads(replace(image, alpha=None), header)
    visible = np.ones(cells.shape, np.bool_)
    if image.alpha is not None:
        least = 0.5 if header.mode == "trinary" else 1.0
        visible = image.alpha >= least * image.white
        cells[~visible] = UNKNOWN
        changed = cells != _as_map_server_reads(image, header)
        if changed.any():
            warnings.warn(
                f"{source}: map_server averages the alpha channel into the grey; by the grey alone, and as "
                f"transparent, {(cells[changed] == UNKNOWN).sum():,} more cells are read as unknown, "
                f"{(cells[changed] != UNKNOWN).sum():,} fewer (as map_server reads them with --strict)",
                stacklevel=3,
            )
    brightness = np.rint(np.arange(image.white + 1) * (255.0 / image.white)).astype(np.uint8)
    brightness = (255 - brightness if header.negate else brightness)[image.grey]
    unknown = visible & (brightness >= UNKNOWN - 1) & (brightness <= UNKNOWN + 1)
    if header.mode == "scale" and (~visible).sum() > unknown.sum():
        return cells  # transparency says what is unknown, so a grey is a probability
    keep_meaning(
        cells,
        brightness,
        visible,
        Thresholds(occupied=header.occupied_thresh, free=header.free_thresh, negate=header.negate),
        source,
    )
    return cells


def _header(path: Path) -> _Header:
    fields = read_yaml_fields(path, MapError, right=KEYS)
    mode = fields.get("mode") or "trinary"
    if not isinstance(mode, str) or mode.lower() not in MODES:
        raise MapError(f"{path}: mode is {short(mode)}; must be one of {', '.join(MODES)}")
    resolution_m = number(_required(fields, "resolution", path))
    if resolution_m is None or resolution_m <= 0.0:
        raise MapError(f"{path}: resolution is {short(fields['resolution'])}; must be metres above 0")
    negate = fields.get("negate", 0)
    if str(negate).lower() not in _NEGATE:
        raise MapError(f"{path}: negate is {short(negate)}; must be 0 or 1")
    occupied_thresh = _threshold(fields, "occupied_thresh", OCCUPIED_THRESH, path)
    free_thresh = _threshold(fields, "free_thresh", FREE_THRESH, path)
    if free_thresh > occupied_thresh:
        raise MapError(
            f"{path}: free_thresh {free_thresh} is above occupied_thresh {occupied_thresh}; usual are "
            f"{FREE_THRESH} and {OCCUPIED_THRESH}"
        )
    return _Header(
        image=_image_name(fields, path),
        mode=mode.lower(),
        resolution_m=resolution_m,
        T_m_g=_origin(fields, path),
        negate=_NEGATE[str(negate).lower()],
        occupied_thresh=occupied_thresh,
        free_thresh=free_thresh,
    )


def _image_name(fields: dict[str, Any], path: Path) -> str:
    image = _required(fields, "image", path)
    if not isinstance(image, str) or not image:
        raise MapError(f"{path}: image is {short(image)}; must be the path of a PGM, PNG, BMP or JPEG")
    return image


def _required(fields: dict[str, Any], key: str, path: Path) -> Any:
    if key not in fields:
        raise MapError(f"{path}: no key {key!r}; must be {KEYS}")
    return fields[key]


def _threshold(fields: dict[str, Any], key: str, default: float, path: Path) -> float:
    value = number(fields.get(key, default))
    if value is None or not 0.0 <= value <= 1.0:
        raise MapError(f"{path}: {key} is {short(fields[key])}; must be a probability from 0 to 1")
    return value


def _origin(fields: dict[str, Any], path: Path) -> SE2:
    origin = numbers(_required(fields, "origin", path))
    if origin is None or len(origin) != 3:
        raise MapError(
            f"{path}: origin is {short(fields['origin'])}; must be [x, y, yaw] in metres and radians"
        )
    yaw_rad = origin[2]
    if abs(yaw_rad) > 2.0 * math.pi:
        warnings.warn(
            f"{path}: origin has a yaw of {yaw_rad:g} rad, more than a turn; radians are meant, and "
            f"{yaw_rad:g}° are {math.radians(yaw_rad):.4f} rad",
            stacklevel=4,
        )
    return SE2.from_array(origin)
