"""Maps of ROS: an image of the occupancy grid and a YAML file beside it (`map_server`, `map_saver`).

How dark a pixel is says how likely its cell is occupied: `p = 1 - grey / white`, or `grey / white` if
`negate` is set. Above `occupied_thresh` a cell is occupied, below `free_thresh` free, else unknown. What the
modes make of that, as in nav2's map_server (ROS 1 differs only where told):

- `trinary`: just that. Transparency is averaged into the grey value as if it were a colour, in ROS 1 as in
  nav2: fully transparent black is `p = 1`, occupied, transparent white `p = 0.25`, unknown.
- `scale`: map_server grades what lies between the thresholds; here that is unknown, as this project's grids
  have three values. A pixel that is not fully opaque is unknown (ROS 1: a fully transparent one between the
  thresholds).
- `raw`: the grey value itself (0 to 255) is the occupancy in per cent, `p = grey / 100`; above 100 it is
  unknown. The same thresholds reduce it to three values. `negate` does nothing (it does in ROS 1), nor does
  transparency.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rendezvous.errors import MapError
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, Cells, Mask, OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.interop.map_image import MapImage, read_map_image
from rendezvous.interop.yaml_fields import number, numbers, read_yaml_fields, short

OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
"""With these, grey 205 (probability 0.1961) loads as unknown; a free_thresh of 0.25 would make it free."""

MODES = ("trinary", "scale", "raw")
KEYS = "a ROS map's image, resolution and origin"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Header:
    """What the YAML file says."""

    image: str
    mode: str
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
    image, header = ros_map_bytes(grid, image_path.name)
    image_path.write_bytes(image)
    yaml_path.write_bytes(header)
    return image_path


def ros_map_bytes(grid: OccupancyGrid, image_name: str) -> tuple[bytes, bytes]:
    """What `write_ros_map` writes: the PGM, and the YAML that calls it by this name."""
    height, width = grid.cells.shape
    x_m, y_m, yaw_rad = (float(value) for value in grid.T_m_g.wrapped().as_array())
    header = (
        f"image: {image_name}\nmode: trinary\nresolution: {grid.resolution_m!r}\n"
        f"origin: [{x_m!r}, {y_m!r}, {yaw_rad!r}]\nnegate: 0\n"
        f"occupied_thresh: {OCCUPIED_THRESH}\nfree_thresh: {FREE_THRESH}\n"
    )
    return f"P5\n{width} {height}\n255\n".encode() + grid.cells[::-1].tobytes(), header.encode()


def read_ros_map(yaml_path: Path, *, strict: bool) -> OccupancyGrid:
    """Reads a map of ROS, of any mode, as a trinary grid.

    Some versions of nav2 saved `free_thresh: 0.25`, with which the unknown cells (205) of their own trinary
    files load as free. Such cells are read as unknown, with a warning.

    Args:
        yaml_path: the YAML file; `image` in it is absolute or relative to its folder.
        strict: keep to the thresholds as they are written, also there.

    Raises:
        MapError: a file is missing or no map, or a key is missing or wrong; says which.
    """
    header = _header(yaml_path)
    image = read_map_image(yaml_path.parent / header.image)
    shades, white = _shades(image, header)
    values = _values_of_shades(header, white)
    if not strict and header.mode == "trinary" and image.alpha is None and image.white == 255:
        _keep_unknown(values, _occurring(shades), header, yaml_path)
    cells = values[shades]
    if header.mode == "scale" and image.alpha is not None:
        cells[image.alpha < image.white] = UNKNOWN
    return OccupancyGrid(
        cells=np.ascontiguousarray(cells[::-1]), resolution_m=header.resolution_m, T_m_g=header.T_m_g
    )


def map_image_path(yaml_path: Path) -> Path:
    """The image that the YAML file of a ROS map names.

    Raises:
        MapError: the file is missing or no YAML, or names none.
    """
    return yaml_path.parent / _image_name(read_yaml_fields(yaml_path, MapError, right=KEYS), yaml_path)


def _shades(
    image: MapImage, header: _Header
) -> tuple[np.ndarray[Any, np.dtype[np.unsignedinteger[Any]]], int]:
    """(H, W) how bright each pixel is, and the value of white."""
    if header.mode != "trinary" or image.alpha is None:
        return image.grey, image.white
    return image.grey.astype(np.uint32) * 3 + image.alpha, 4 * image.white


def _values_of_shades(header: _Header, white: int) -> Cells:
    """(white + 1,) uint8: the grid's value for each shade."""
    probability = _probability(header, white)
    values = np.full(white + 1, UNKNOWN, np.uint8)
    values[probability < header.free_thresh] = FREE
    values[probability > header.occupied_thresh] = OCCUPIED
    return values


def _probability(header: _Header, white: int) -> Array:
    """(white + 1,) of being occupied, for each shade; NaN where the shade says unknown."""
    shade = np.arange(white + 1)
    if header.mode == "raw":
        percent = np.round(255.0 * shade / white)
        return np.where(percent <= 100.0, percent / 100.0, np.nan)
    return (shade if header.negate else white - shade) / white


def _occurring(shades: np.ndarray[Any, Any]) -> Mask:
    """(256,) bool: which greys the image has."""
    occurring = np.zeros(256, np.bool_)
    occurring[shades] = True
    return occurring


def _keep_unknown(values_in_place: Cells, occurring: Mask, header: _Header, source: Path) -> None:
    """Makes the grey of unknown cells unknown if the image has no greys but those that map_saver writes."""
    grey = 255 - UNKNOWN if header.negate else UNKNOWN
    others = np.delete(occurring, [0, 1, grey, 254, 255])
    if others.any() or not occurring[grey] or values_in_place[grey] != FREE:
        return
    warnings.warn(
        f"{source}: free_thresh {header.free_thresh} makes grey {grey}, unknown in a trinary map, free; read "
        "as unknown",
        stacklevel=3,
    )
    values_in_place[grey] = UNKNOWN


def _header(path: Path) -> _Header:
    fields = read_yaml_fields(path, MapError, right=KEYS)
    image = _image_name(fields, path)
    mode = fields.get("mode", "trinary")
    if mode not in MODES:
        raise MapError(f"{path}: mode is {short(mode)}; must be one of {', '.join(MODES)}")
    resolution_m = number(_required(fields, "resolution", path))
    if resolution_m is None or resolution_m <= 0.0:
        raise MapError(f"{path}: resolution is {short(fields['resolution'])}; must be metres above 0")
    negate = fields.get("negate", 0)
    if negate not in (0, 1):
        raise MapError(f"{path}: negate is {short(negate)}; must be 0 or 1")
    occupied_thresh = _threshold(fields, "occupied_thresh", OCCUPIED_THRESH, path)
    free_thresh = _threshold(fields, "free_thresh", FREE_THRESH, path)
    if free_thresh >= occupied_thresh:
        raise MapError(
            f"{path}: free_thresh {free_thresh} is not below occupied_thresh {occupied_thresh}; usual are "
            f"{FREE_THRESH} and {OCCUPIED_THRESH}"
        )
    return _Header(
        image=image,
        mode=mode,
        resolution_m=resolution_m,
        T_m_g=_origin(fields, path),
        negate=bool(negate),
        occupied_thresh=occupied_thresh,
        free_thresh=free_thresh,
    )


def _image_name(fields: dict[str, Any], path: Path) -> str:
    image = _required(fields, "image", path)
    if not isinstance(image, str) or not image:
        raise MapError(f"{path}: image is {short(image)}; must be the path of a PGM, PNG or BMP")
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
