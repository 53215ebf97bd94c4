"""The MuJoCo scene: walls and furniture as static geoms, robots on wheels or on planar joints.

Walls are boxes: they compile and collide faster than meshes, and a concave mesh would collide as its
convex hull.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from xml.sax.saxutils import quoteattr

import numpy as np

from rendezvous.floorplan.records import Shape, Solid
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.simulation.robot import RobotSpec


class Drive(StrEnum):
    """How a robot moves: two driven wheels with slip, or planar joints that follow the twist."""

    WHEELS = "wheels"
    PLANAR = "planar"


SLOT_Z_M = -100.0  # height of unused slots, out of every robot's reach
TIMESTEP_S = {Drive.WHEELS: 0.005, Drive.PLANAR: 0.010}

_RGBA = {"wall": "0.85 0.83 0.78 1"}
_FURNITURE_RGBA = "0.55 0.42 0.30 1"
_ROBOT_RGBA = ("0.10 0.35 0.75 1", "0.80 0.20 0.15 1")

# Two geoms collide if one's contype shares a bit with the other's conaffinity. Wheels and caster touch only
# the floor, the shell (with fenders for the wheels) everything else. MuJoCo compares bodies before geoms:
# with the walls in one body, only shells are checked against them.
_SCENE_MASK = 'contype="1" conaffinity="2"'
_FLOOR_MASK = 'contype="4" conaffinity="4"'
_WHEEL_MASK = 'contype="4" conaffinity="4"'


def collision_masks(only_for: int | None) -> tuple[int, int]:
    """contype and conaffinity of a solid: of all robots' world, or of that of one robot alone."""
    return (1, 2) if only_for is None else (8 << only_for, 0)


def _shell_mask(robot: int, *, own_worlds: bool) -> str:
    return f'contype="2" conaffinity="{3 | (8 << robot if own_worlds else 0)}"'


def scene_mjcf(
    solids: Sequence[Solid],
    robots: Sequence[RobotSpec],
    starts: Sequence[SE2],
    *,
    drive: Drive = Drive.WHEELS,
    slots: int = 0,
    own_worlds: bool = False,
) -> str:
    """A standalone MJCF of the scene with the robots in it.

    Bodies are named `r0`, `r1`, ... and start at the robots' poses in w; `slots` geoms named `slot0`,
    `slot1`, ... lie far below the floor, to be filled with solids later; with `own_worlds` a slot may hold
    what only one of the robots runs into, see `collision_masks`.
    """
    # The body of the slots has the bits of all of them from the start.
    slot_mask = f' contype="{1 | 8 | 16}" conaffinity="2"' if own_worlds else ""
    geoms = "\n".join(
        [_solid_geom(solid) for solid in solids]
        + [
            f'    <geom name="slot{i}" type="box" size="1 1 1" pos="0 0 {SLOT_Z_M}"{slot_mask}/>'
            for i in range(slots)
        ]
    )
    bodies = "\n".join(
        _robot_body(f"r{i}", spec, T_w_r, _ROBOT_RGBA[i % 2], drive, _shell_mask(i, own_worlds=own_worlds))
        for i, (spec, T_w_r) in enumerate(zip(robots, starts, strict=True))
    )
    actuators = "\n".join(_actuators(f"r{i}", spec, drive) for i, spec in enumerate(robots))
    return f"""<mujoco model="rendezvous">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{TIMESTEP_S[drive]}" integrator="implicitfast" cone="elliptic" iterations="20"/>
  <size memory="16M"/>
  <visual><headlight ambient="0.4 0.4 0.4" diffuse="0.5 0.5 0.5"/></visual>
  <default>
    <geom {_SCENE_MASK} friction="0.9 0.005 0.0001"/>
  </default>
  <worldbody>
    <light pos="0 0 4" dir="0.2 0.1 -1" directional="true"/>
    <geom name="floor" type="plane" size="0 0 1" rgba="0.75 0.72 0.68 1" {_FLOOR_MASK}/>
    <body name="scene">
{geoms}
    </body>
{bodies}
  </worldbody>
  <actuator>
{actuators}
  </actuator>
</mujoco>
"""


def _solid_geom(solid: Solid) -> str:
    half_z_m = 0.5 * (solid.z1_m - solid.z0_m)
    pos = f"{solid.x_m:.9g} {solid.y_m:.9g} {solid.z0_m + half_z_m:.9g}"
    rgba = _RGBA.get(solid.category, _FURNITURE_RGBA)
    if solid.shape is Shape.CYLINDER:
        form = f'type="cylinder" size="{solid.half_x_m:.6g} {half_z_m:.6g}"'
    else:
        half = math.sin(0.5 * solid.yaw_rad)
        quat_wxyz = f"{math.cos(0.5 * solid.yaw_rad):.9g} 0 0 {half:.9g}"
        form = (
            f'type="box" size="{solid.half_x_m:.6g} {solid.half_y_m:.6g} {half_z_m:.6g}" quat="{quat_wxyz}"'
        )
    return f'    <geom {form} pos="{pos}" rgba="{rgba}"/>'


def _robot_body(name: str, spec: RobotSpec, T_w_r: SE2, rgba: str, drive: Drive, mask: str) -> str:
    """The robot's body at its start; the frame of the body is r."""
    pose = (
        f'pos="{T_w_r.x_m:.9g} {T_w_r.y_m:.9g} 0" '
        f'quat="{math.cos(0.5 * T_w_r.yaw_rad):.12g} 0 0 {math.sin(0.5 * T_w_r.yaw_rad):.12g}"'
    )
    moving = _wheels(name, spec) if drive is Drive.WHEELS else ""
    joints = f'<freejoint name="{name}"/>' if drive is Drive.WHEELS else _planar_joints(name)
    chassis = spec.chassis
    height_m = chassis.top_z_m - chassis.bottom_z_m
    lidar_half_m = 0.5 * (spec.size_m[2] - chassis.top_z_m)
    body_mass_kg = spec.mass_kg - 2 * spec.wheels.mass_kg
    camera = spec.camera
    return f"""    <body name={quoteattr(name)} {pose}>
      {joints}
      <inertial pos="{0.6 * chassis.centre_x_m:.6g} 0 {0.45 * chassis.top_z_m:.6g}" mass="{body_mass_kg:.6g}"
        diaginertia="{_cylinder_inertia(body_mass_kg, chassis.radius_m, height_m)}"/>
      <geom type="cylinder" size="{spec.lidar.cap_radius_m} {lidar_half_m:.6g}" rgba="0.1 0.1 0.1 1"
        contype="0" conaffinity="0" pos="{spec.lidar.x_m} 0 {chassis.top_z_m + lidar_half_m:.6g}"/>
      <camera name="{name}_camera" {_camera_pose(spec)}
        fovy="{math.degrees(2 * math.atan(0.5 * camera.height_px / camera.fy_px)):.6g}"/>
{_shell(name, spec, rgba, mask)}{moving}    </body>"""


def _camera_pose(spec: RobotSpec) -> str:
    """MuJoCo's cameras have x right and y up; the optical frame has y down. Its fovy is in degrees."""
    T_r_c = spec.camera.T_r_c()
    axes = np.concatenate([T_r_c[:3, 0], -T_r_c[:3, 1]])
    return f'pos="{_numbers(T_r_c[:3, 3])}" xyaxes="{_numbers(axes)}"'


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.9g}" for value in values.tolist())


def _cylinder_inertia(mass_kg: float, radius_m: float, height_m: float) -> str:
    across = mass_kg * (3 * radius_m**2 + height_m**2) / 12
    return f"{across:.6g} {across:.6g} {0.5 * mass_kg * radius_m**2:.6g}"


def _shell(name: str, spec: RobotSpec, rgba: str, mask: str) -> str:
    """The parts that bump into things, as a body of their own: the chassis, and fenders for the wheels."""
    chassis, wheels = spec.chassis, spec.wheels
    half_m = 0.5 * (chassis.top_z_m - chassis.bottom_z_m)
    fenders = "".join(
        f'        <geom type="box" size="{wheels.radius_m} {0.5 * wheels.width_m} {0.5 * wheels.radius_m}" '
        f'pos="0 {sign * 0.5 * wheels.track_m:.6g} {1.5 * wheels.radius_m:.6g}" mass="0" friction="0.3" '
        f'{mask} rgba="0 0 0 0"/>\n'
        for sign in (1.0, -1.0)
    )
    return (
        f'      <body name="{name}_shell">\n'
        f'        <geom type="cylinder" size="{chassis.radius_m} {half_m:.6g}" rgba="{rgba}" mass="0" '
        f'friction="0.3" {mask} pos="{chassis.centre_x_m} 0 {chassis.bottom_z_m + half_m:.6g}"/>\n'
        f"{fenders}      </body>\n"
    )


def _wheels(name: str, spec: RobotSpec) -> str:
    """Ellipsoid wheels and a ball caster without friction.

    Cylinder wheels roll on an edge and slip more. A contact takes the higher friction of its two geoms, so
    the caster needs priority to slide. (With pyramidal friction cones a robot that drives straight, but not
    along an axis of the world, drifts by 2 degrees over 2 m.)
    """
    wheels, caster = spec.wheels, spec.caster
    out = [
        f'      <geom type="sphere" size="{caster.radius_m}" pos="{caster.x_m} 0 {caster.radius_m}" '
        f'priority="1" condim="1" {_WHEEL_MASK} rgba="0.2 0.2 0.2 1"/>\n'
    ]
    spin = 0.5 * wheels.mass_kg * wheels.radius_m**2
    for side, sign in (("left", 1.0), ("right", -1.0)):
        out.append(
            f'      <body name="{name}_{side}" pos="0 {sign * 0.5 * wheels.track_m:.6g} {wheels.radius_m}">\n'
            f'        <joint name="{name}_{side}" axis="0 1 0" damping="1e-4" armature="2e-4"/>\n'
            f'        <inertial pos="0 0 0" mass="{wheels.mass_kg}" '
            f'diaginertia="{0.6 * spin:.6g} {spin:.6g} {0.6 * spin:.6g}"/>\n'
            f'        <geom type="ellipsoid" size="{wheels.radius_m} {0.5 * wheels.width_m} '
            f'{wheels.radius_m}" {_WHEEL_MASK} rgba="0.15 0.15 0.15 1"/>\n'
            f"      </body>\n"
        )
    return "".join(out)


def _planar_joints(name: str) -> str:
    """Slides along the start pose's axes, then a hinge at r."""
    return (
        f'<joint name="{name}_x" type="slide" axis="1 0 0"/>'
        f'<joint name="{name}_y" type="slide" axis="0 1 0"/>'
        f'<joint name="{name}_yaw" type="hinge" axis="0 0 1"/>'
    )


def _actuators(name: str, spec: RobotSpec, drive: Drive) -> str:
    if drive is Drive.WHEELS:
        # Stall torque of the XL430; a stiffer velocity loop breaks the tyres' grip at every change of speed.
        return "\n".join(
            f'    <velocity name="{name}_{side}" joint="{name}_{side}" kv="0.03" forcerange="-1.5 1.5"/>'
            for side in ("left", "right")
        )
    gains = {"x": 40.0 * spec.mass_kg, "y": 40.0 * spec.mass_kg, "yaw": 0.1 * spec.mass_kg}
    return "\n".join(
        f'    <velocity name="{name}_{axis}" joint="{name}_{axis}" kv="{gain:.6g}"/>'
        for axis, gain in gains.items()
    )
