"""The tables of the dataset, defined only here: column names, Arrow types, units and meanings.

`explore` writes `EXPLORE`; `render` writes their images, `VIEWS`, and training images, `POSES`; `pack`
publishes `PAIRS` (sightings with their images) and `POSES`. Frames: w the floor plan, m0 and m1 the robots'
maps (their true start poses), r0 and r1 the robots on the floor between their wheels, c the observer's camera
(OpenCV axes), o the centre of the seen robot's cuboid.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyarrow as pa

from rendezvous.geometry.cuboid import CUBOID_CORNER_SIGNS as CUBOID_CORNER_SIGNS
from rendezvous.geometry.se2 import SE2, Array

SCHEMA_VERSION = 2
"""Raised when a column changes its name, type, unit or meaning, for readers of published files.

What is made again does not depend on it: shards depend on the columns themselves."""

SE2_TYPE = pa.list_(pa.float64(), 3)
SE3_TYPE = pa.list_(pa.float64(), 16)
K_TYPE = pa.list_(pa.float64(), 9)
BOX_TYPE = pa.list_(pa.float64(), 4)
CUBOID_TYPE = pa.list_(pa.list_(pa.float64(), 2), 9)
SIZE_TYPE = pa.struct([(n, pa.float64()) for n in ("x_m", "y_m", "z_m")])
IMAGE_TYPE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
TRAJECTORY_TYPE = pa.list_(pa.struct([(n, pa.float64()) for n in ("t_s", "x_m", "y_m", "yaw_rad")]))
SOLIDS_TYPE = pa.list_(
    pa.struct(
        [("shape", pa.string())]
        + [(n, pa.float64()) for n in ("x_m", "y_m", "yaw_rad", "half_x_m", "half_y_m", "z0_m", "z1_m")]
        + [("category", pa.string()), ("item", pa.int32())]
    )
)

_SHAPES: dict[pa.DataType, tuple[int, ...]] = {
    SE2_TYPE: (3,),
    SE3_TYPE: (4, 4),
    K_TYPE: (3, 3),
    BOX_TYPE: (4,),
    CUBOID_TYPE: (9, 2),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """One column."""

    name: str
    type: pa.DataType
    unit: str = ""
    about: str
    nullable: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class TableSchema:
    """One table."""

    name: str
    columns: tuple[Column, ...]

    def arrow(self) -> pa.Schema:
        """The Arrow schema, with metadata that lets Hugging Face `datasets` decode images.

        Every Arrow field is nullable, because `datasets` accepts no others.
        """
        images = {c.name: {"_type": "Image"} for c in self.columns if c.type == IMAGE_TYPE}
        metadata = {
            "huggingface": json.dumps({"info": {"features": images}}),
            "rendezvous": json.dumps({"table": self.name, "schema_version": SCHEMA_VERSION}),
        }
        return pa.schema([pa.field(c.name, c.type) for c in self.columns], metadata=metadata)

    def table(self, rows: Sequence[Mapping[str, Any]]) -> pa.Table:
        """The rows as an Arrow table.

        Args:
            rows: values by column name. An SE(2) pose is an `SE2` or a (3,) array, an SE(3) pose (4, 4), `K`
                (3, 3), a trajectory (N, 4) of t, x, y, yaw, an image its encoded bytes, a size (3,), solids a
                list of mappings. Nullable columns may be left out.

        Raises:
            ValueError: a column is missing or unknown, or a value is not finite or has the wrong type or
                shape; says which row and column.
        """
        names = {c.name for c in self.columns}
        for i, row in enumerate(rows):
            if unknown := sorted(row.keys() - names):
                raise ValueError(f"{self.name} row {i}: no columns {unknown} in the schema")
        schema = self.arrow()
        arrays = [
            pa.array([_checked(row.get(c.name), c, i) for i, row in enumerate(rows)], type=c.type)
            for c in self.columns
        ]
        return pa.Table.from_arrays(arrays, schema=schema)

    def rows(self, table: pa.Table) -> list[dict[str, Any]]:
        """Inverse of `table`, for the columns that the table has: `SE2`, arrays and bytes."""
        present = [c for c in self.columns if c.name in table.column_names]
        values = {c.name: [_natural(v, c) for v in table[c.name].to_pylist()] for c in present}
        return [dict(zip(values, row, strict=True)) for row in zip(*values.values(), strict=True)]


def _checked(value: Any, column: Column, row: int) -> Any:
    """The value in the form that Arrow takes."""
    where = f"row {row}, column {column.name}"
    if value is None:
        if not column.nullable:
            raise ValueError(f"{where}: missing; the column must have a value")
        return None
    if column.type in _SHAPES:
        # A point of the cuboid behind the camera is NaN.
        finite = column.type != CUBOID_TYPE
        array = _floats(value, _SHAPES[column.type], where, finite=finite)
        return array.tolist() if column.type == CUBOID_TYPE else array.ravel().tolist()
    if column.type == SIZE_TYPE:
        return dict(zip(("x_m", "y_m", "z_m"), _floats(value, (3,), where).tolist(), strict=True))
    if column.type == TRAJECTORY_TYPE:
        poses = _floats(value, (len(value), 4), where)
        return [dict(zip(("t_s", "x_m", "y_m", "yaw_rad"), p, strict=True)) for p in poses.tolist()]
    if column.type == IMAGE_TYPE:
        if not isinstance(value, bytes):
            raise ValueError(f"{where}: {type(value).__name__}; must be the bytes of an encoded image")
        return {"bytes": value, "path": None}
    if column.type == pa.float64():
        return float(_floats(value, (), where))
    return value


def _floats(value: Any, shape: tuple[int, ...], where: str, *, finite: bool = True) -> Array:
    array = np.asarray(value.as_array() if isinstance(value, SE2) else value, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{where}: shape {array.shape}; must be {shape}")
    if finite and not np.isfinite(array).all():
        raise ValueError(f"{where}: {array.tolist()} is not finite")
    return array


def _natural(value: Any, column: Column) -> Any:
    if value is None:
        return None
    if column.type == SE2_TYPE:
        return SE2.from_array(value)
    if column.type in _SHAPES:
        return np.array(value).reshape(_SHAPES[column.type])
    if column.type == TRAJECTORY_TYPE:
        return np.array([list(p.values()) for p in value]).reshape(-1, 4)
    if column.type == SIZE_TYPE:
        return np.array(list(value.values()))
    if column.type == IMAGE_TYPE:
        return value["bytes"]
    return value


def _each_robot(name: str, type_: pa.DataType, unit: str, about: str) -> Iterable[Column]:
    """One column for each robot; `{i}` in name and description becomes the robot's number."""
    for i in "01":
        yield Column(name=name.replace("{i}", i), type=type_, unit=unit, about=about.replace("{i}", i))


_POSE = "m, m, rad"
_TRAJECTORY = "s, m, m, rad"

# One column a line, however long, so that the block reads as a table.
# ruff: noqa: E501
_IDENTITY = (
    Column(name="pair_id", type=pa.string(), about="Unique name of this row: the event and its observer."),
    Column(name="event_id", type=pa.string(), about="The rendezvous; its two rows share it if both robots see each other."),
    Column(name="episode_id", type=pa.string(), about="The exploration of one plan from one pair of starts. After it, if they were drawn, both robots' lidars and the share of the furniture that changed between them: ` lidars=NAME,NAME changed=0.42`. Of recorded pairs their source: the log's file, the start of its SHA-256, and the scans of each robot in the order of driving."),
    Column(name="observer", type=pa.int32(), about="Which robot of the episode, 0 or 1, is this row's robot 0."),
    Column(name="plan_id", type=pa.string(), about="Name of the floor plan; of the building where a log was recorded."),
    Column(name="plan_digest", type=pa.string(), about="SHA-256 of the plan's geometry (of the building's name); splits go by it."),
    Column(name="seed", type=pa.int64(), about="The run's root seed."),
    Column(name="t_s", type=pa.float64(), unit="s", about="Simulated time of the sighting, since the robots started."),
    Column(name="drive", type=pa.string(), about="How the robots were driven: `wheels` or `planar`; `recorded` in pairs of real logs."),
    Column(name="furniture_density", type=pa.float64(), nullable=True, about="Density of the furniture; 0 for empty rooms, null in recorded pairs."),
)  # fmt: skip

_MAPS = (
    *_each_robot("map_{i}", IMAGE_TYPE, "", "Robot {i}'s occupancy grid as PNG: 0 occupied, 205 unknown, 254 free; top row = largest y."),
    *_each_robot("origin_{i}", SE2_TYPE, _POSE, "Pose in m{i} of the lower-left corner of `map_{i}`."),
    Column(name="resolution_m", type=pa.float64(), unit="m", about="Side of a cell of both maps."),
)  # fmt: skip

_POSES = (
    *_each_robot("T_m{i}_r{i}", SE2_TYPE, _POSE, "Robot {i}'s pose in its own map as its SLAM estimates it."),
    *_each_robot("T_m{i}_r{i}_true", SE2_TYPE, _POSE, "Robot {i}'s true pose in its own map frame."),
    *_each_robot("T_m{i}_r{i}_odometry", SE2_TYPE, _POSE, "Robot {i}'s pose by wheel odometry alone."),
    *_each_robot("T_w_m{i}", SE2_TYPE, _POSE, "True start pose of robot {i} in the floor plan."),
    Column(name="T_r0_r1_true", type=SE2_TYPE, unit=_POSE, about="True pose of robot 1 seen from robot 0."),
    Column(name="T_m0_m1", type=SE2_TYPE, unit=_POSE, about="True pose of map frame 1 in map frame 0, from the starts."),
    Column(name="T_m0_m1_local", type=SE2_TYPE, unit=_POSE, about="`T_m0_r0 · T_r0_r1_true · T_m1_r1⁻¹`: makes the maps agree where the robots meet, free of each map's drift. The label to learn."),
    *_each_robot("slam_position_error_{i}_m", pa.float64(), "m", "Distance of `T_m{i}_r{i}` from the truth."),
    *_each_robot("slam_heading_error_{i}_rad", pa.float64(), "rad", "Angle of `T_m{i}_r{i}` from the truth, absolute."),
    *_each_robot("odometry_position_error_{i}_m", pa.float64(), "m", "Distance of `T_m{i}_r{i}_odometry` from the truth."),
    *_each_robot("odometry_heading_error_{i}_rad", pa.float64(), "rad", "Angle of `T_m{i}_r{i}_odometry` from the truth, absolute."),
    *_each_robot("trajectory_{i}", TRAJECTORY_TYPE, _TRAJECTORY, "Robot {i}'s path in m{i} up to `t_s`, as its SLAM estimated it on the way: a pose at the first lidar sweep (0.2 s after the start), then about every second and at each rendezvous. `yaw_rad` is unrolled, so it goes on beyond ±π."),
    *_each_robot("trajectory_{i}_true", TRAJECTORY_TYPE, _TRAJECTORY, "Robot {i}'s true path in m{i}, at the same times; `yaw_rad` is unrolled as well."),
)  # fmt: skip

_QUALITY = (
    Column(name="overlap", type=pa.float64(), about="|known_0 ∩ known_1| / |known_0 ∪ known_1| of the maps aligned by `T_m0_m1_local`."),
    Column(name="wall_agreement_local", type=pa.float64(), nullable=True, about="Share of the occupied cells inside the other map's known area (both ways) that lie within 0.10 m of one of its occupied cells, aligned by `T_m0_m1_local`; null if there are none."),
    Column(name="wall_agreement", type=pa.float64(), nullable=True, about="The same, aligned by `T_m0_m1`."),
    *_each_robot("occupied_cells_{i}", pa.int32(), "", "Number of occupied cells of `map_{i}`."),
    *_each_robot("ghost_cells_{i}", pa.int32(), "", "Number of these cells that the other robot left: near its true path, far from every true wall and piece of furniture."),
)  # fmt: skip

_CAMERA = (
    Column(name="image_width_px", type=pa.int32(), unit="px", about="Width of the camera's image."),
    Column(name="image_height_px", type=pa.int32(), unit="px", about="Height of the camera's image."),
    Column(name="K", type=K_TYPE, unit="px", about="Camera matrix, row-major; pixel (0, 0) is the centre of the first pixel."),
)  # fmt: skip

_SEEN_ROBOT = (
    Column(name="robot", type=pa.string(), about="Kind of the seen robot: the name in its robot file."),
    Column(name="cuboid_size_m", type=SIZE_TYPE, unit="m", about="Sides of that robot's cuboid along the axes of o."),
    Column(name="T_r1_o", type=SE3_TYPE, unit="m", about="Pose of the cuboid on robot 1, row-major 4×4."),
)  # fmt: skip

_SIGHTING = (
    Column(name="range_m", type=pa.float64(), unit="m", about="Distance from the camera to the centre of robot 1's cuboid."),
    Column(name="bearing_rad", type=pa.float64(), unit="rad", about="Direction of that centre from robot 0's heading, seen from r0, left positive."),
    Column(name="visible_fraction", type=pa.float64(), about="Share of robot 1's cuboid sample points that project into the image with nothing in front."),
    *_CAMERA,
    Column(name="T_r0_c", type=SE3_TYPE, unit="m", about="Pose of the camera on robot 0, row-major 4×4."),
    *_SEEN_ROBOT,
)  # fmt: skip

_DRAWN = Column(
    name="drawn",
    type=pa.string(),
    about="Everything drawn at random for the image, as JSON: light, materials, distractors, camera settings and flaws; seeds of backgrounds, noise and furniture; and the renderer.",
)

_LABEL = (
    Column(name="T_c_o", type=SE3_TYPE, unit="m", nullable=True, about="Pose of the seen robot's cuboid in the camera, row-major 4×4: `T_r0_r1 = T_r0_c · T_c_o · T_r1_o⁻¹`; null where the robot is absent."),
    Column(name="projected_cuboid_px", type=CUBOID_TYPE, unit="px", nullable=True, about="The cuboid's corners in the image in DOPE's order, centroid last; NaN for one behind the camera; null where the robot is absent."),
    Column(name="visibility", type=pa.float64(), about="Visible pixels of the robot / pixels of its whole silhouette, of which the part outside the image counts as hidden; 0 where it is absent."),
    Column(name="visible_px", type=pa.int32(), unit="px", about="Number of visible pixels of the robot."),
    Column(name="silhouette_px", type=pa.int32(), unit="px", about="Number of pixels that it would cover with nothing in front of it, in and outside the image."),
    Column(name="box_px", type=BOX_TYPE, unit="px", nullable=True, about="Box x0, y0, x1, y1 around the visible pixels; null where there are none."),
    _DRAWN,
)  # fmt: skip

_IMAGE = Column(name="image", type=IMAGE_TYPE, about="What the camera sees: JPEG, or PNG if set so.")

_VIEW = (_IMAGE, *_LABEL)

VIEWS = TableSchema(
    name="views", columns=(*(c for c in _IDENTITY if c.name in ("pair_id", "plan_id")), *_VIEW)
)
"""Images of sightings with labels; `pack` joins them to `PAIRS` by `pair_id`."""

POSES = TableSchema(
    name="poses",
    columns=(
        Column(name="pose_id", type=pa.string(), about="Unique name of this row: the plan and a number."),
        *(c for c in _IDENTITY if c.name in ("plan_id", "plan_digest", "seed")),
        Column(name="mode", type=pa.string(), about="`plausible`: on the floor of a furnished room, seen by another robot's camera; `free`: anywhere before any background."),
        _IMAGE,
        *_CAMERA,
        Column(name="T_r0_c", type=SE3_TYPE, unit="m", nullable=True, about="Pose of the camera on robot 0 as its file has it, row-major 4×4; null in `free` images, which no robot takes."),
        Column(name="T_r0_c_true", type=SE3_TYPE, unit="m", nullable=True, about="True pose of the camera when the image was taken: the robot stands a little askew."),
        *_SEEN_ROBOT,
        *_LABEL,
    ),
)  # fmt: skip
"""Training images for the pose estimator."""

SIGHTINGS = (*_IDENTITY, *_MAPS, *_POSES, *_QUALITY, *_SIGHTING)

PAIRS = TableSchema(name="pairs", columns=(*SIGHTINGS, *(replace(c, nullable=True) for c in _VIEW)))
"""Published sightings; robot 0 is the observer. The columns of `VIEWS` are null without an image."""

_FURNITURE = Column(
    name="furniture", type=SOLIDS_TYPE, unit="m, rad", about="The episode's furniture in w, for the renderer."
)

EXPLORE = TableSchema(name="explore", columns=(*SIGHTINGS, _FURNITURE))
"""Sightings as `explore` writes them, with the furniture for the renderer."""
