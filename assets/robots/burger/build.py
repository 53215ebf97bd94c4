"""Builds `robot.glb`, the looks of a TurtleBot3 Burger with a RealSense D435, and its `robot.xml`.

python assets/robots/burger/build.py

Where things are and how large they are comes from `robot.yaml`; the sizes below are those of bought parts
that nothing but a picture needs (ROBOTIS e-Manual and drawings, LDS-01, OpenCR, Raspberry Pi and D435 data
sheets). Lengths [m] in the robot frame r: on the floor between the wheels, x forward, y left, z up.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import shapely
from shapely import affinity

from rendezvous.geometry.se2 import SE2
from rendezvous.rendering.robot_model import SolidParts, at, robot_glb
from rendezvous.rendering.scene import Material
from rendezvous.robot_file import load_robot
from rendezvous.simulation.robot import RobotSpec
from rendezvous.simulation.world import scene_mjcf

HERE = Path(__file__).parent

MATERIALS = {
    "battery": Material(base_colour_rgb=(0.03, 0.11, 0.45), roughness=0.45),
    "board_lds": Material(base_colour_rgb=(0.55, 0.56, 0.58), roughness=0.5),
    "board_opencr": Material(base_colour_rgb=(0.01, 0.05, 0.10), roughness=0.5),
    "board_pi": Material(base_colour_rgb=(0.01, 0.18, 0.05), roughness=0.5),
    "camera_body": Material(base_colour_rgb=(0.62, 0.63, 0.65), metallic=0.7, roughness=0.35),
    "camera_face": Material(base_colour_rgb=(0.012, 0.012, 0.014), roughness=0.12),
    "caster": Material(base_colour_rgb=(0.75, 0.75, 0.76), metallic=0.8, roughness=0.3),
    "chips": Material(base_colour_rgb=(0.02, 0.02, 0.02), roughness=0.4),
    "connectors": Material(base_colour_rgb=(0.66, 0.66, 0.68), metallic=0.85, roughness=0.35),
    "housings": Material(base_colour_rgb=(0.05, 0.05, 0.055), roughness=0.5),
    "label": Material(base_colour_rgb=(0.75, 0.55, 0.05), roughness=0.5),
    "lenses": Material(base_colour_rgb=(0.10, 0.04, 0.12), metallic=0.4, roughness=0.08),
    "lidar_base": Material(base_colour_rgb=(0.045, 0.045, 0.05), roughness=0.55),
    "lidar_head": Material(base_colour_rgb=(0.025, 0.025, 0.03), roughness=0.3),
    "lidar_window": Material(base_colour_rgb=(0.035, 0.012, 0.016), roughness=0.08),
    "plates": Material(base_colour_rgb=(0.032, 0.033, 0.036), roughness=0.6),
    "rims": Material(base_colour_rgb=(0.16, 0.165, 0.17), roughness=0.5),
    "standoffs": Material(base_colour_rgb=(0.55, 0.55, 0.57), metallic=0.8, roughness=0.35),
    "switch": Material(base_colour_rgb=(0.55, 0.02, 0.02), roughness=0.4),
    "tyres": Material(base_colour_rgb=(0.014, 0.014, 0.015), roughness=0.9),
}

LAYERS = 4
PLATE_M = 0.004
CUT_CORNER_M = 0.036
HOLE_PITCH_M, HOLE_RADIUS_M = 0.0145, 0.0036

MOTOR_M = (0.0465, 0.034, 0.0285)  # Dynamixel XL430, axle 11 mm from its front
MOTOR_AXLE_M = 0.011
BATTERY_M = (0.088, 0.035, 0.026)
OPENCR_M = (0.105, 0.075, 0.0016)
PI_M = (0.085, 0.056, 0.0016)
BOARD_GAP_M = 0.006
BOARD_POST_M = [(0.0, 0.0), (0.0022, 0.0), (0.0022, BOARD_GAP_M), (0.0, BOARD_GAP_M)]

LIDAR_BASE_RADIUS_M, LIDAR_BASE_M, LIDAR_LENGTH_M = 0.03475, 0.0165, 0.0955

CAMERA_M = (0.025, 0.090, 0.025)  # D435; places of its lenses across the body, left positive
CAMERA_COLOUR_Y_M = 0.0325
CAMERA_LENSES = ((0.0325, 0.0040), (0.0175, 0.0055), (-0.0115, 0.0050), (-0.0325, 0.0055))


class Burger(SolidParts):
    """The robot's parts as they are collected."""

    def __init__(self, spec: RobotSpec) -> None:
        super().__init__(MATERIALS)
        self.spec = spec
        undersides_m = np.linspace(spec.chassis.bottom_z_m, spec.chassis.top_z_m - PLATE_M, LAYERS)
        self.undersides_m = [float(z) for z in undersides_m]
        self.tops_m = [z + PLATE_M for z in self.undersides_m]


def plates(robot: Burger) -> None:
    """Waffle plates: octagons with rows of holes."""
    chassis = robot.spec.chassis
    r = chassis.radius_m
    square = shapely.box(-r, -r, r, r)
    stretch = np.sqrt(2.0) * (1.0 - 0.5 * CUT_CORNER_M / r)
    diamond = affinity.scale(affinity.rotate(square, 45.0), stretch, stretch)
    outline = affinity.translate(square.intersection(diamond), chassis.centre_x_m)
    steps = np.arange(-4, 5) * HOLE_PITCH_M
    xy_m = np.stack(np.meshgrid(chassis.centre_x_m + steps, steps), axis=-1).reshape(-1, 2)
    holes = shapely.buffer(shapely.points(xy_m), HOLE_RADIUS_M, quad_segs=2)
    whole = holes[shapely.contains(outline.buffer(-0.004), holes)]
    waffle = outline.difference(shapely.union_all(whole))
    for z_m in robot.undersides_m:
        robot.extrude("plates", waffle, z_m, PLATE_M)


def standoffs(robot: Burger) -> None:
    """Six-sided posts with a screw head on top; the upper front ones stand behind the camera."""
    centre_m = robot.spec.chassis.centre_x_m
    behind_camera_m = robot.spec.camera.xyz_m[0] - CAMERA_M[0] - 0.004 - centre_m
    for layer, (top_m, z_m) in enumerate(zip(robot.tops_m, robot.undersides_m[1:], strict=False)):
        front = (behind_camera_m, 0.060) if layer == LAYERS - 2 else (0.058, 0.027)
        for x_m, y_m in [front, (-0.058, 0.027)]:
            for side in (1.0, -1.0):
                frame = at(centre_m + x_m, side * y_m, top_m)
                height_m = z_m - top_m
                robot.revolve("standoffs", [(0, 0), (0.003, 0), (0.003, height_m), (0, height_m)], 6, frame)
                screw = [(0.0028, 0), (0.0026, 0.0014), (0, 0.0018)]
                robot.revolve("connectors", screw, 8, at(centre_m + x_m, side * y_m, z_m + PLATE_M))


def wheels(robot: Burger) -> None:
    """Tyres with treads, rims with five spokes, and the motors between them."""
    spec = robot.spec.wheels
    radius_m, width_m = spec.radius_m, spec.width_m
    angles = np.linspace(0.0, 2.0 * np.pi, 4 * 30, endpoint=False)
    # Two of four points of a tread are on the full radius, one of them where the tyre touches the floor.
    radii_m = np.where(np.arange(2, 122) % 4 < 2, radius_m, radius_m - 0.0016)
    tread = shapely.Polygon(np.column_stack([radii_m * np.cos(angles), radii_m * np.sin(angles)]))
    tyre = tread.difference(shapely.Point(0, 0).buffer(0.74 * radius_m, quad_segs=9))
    spokes = [
        affinity.rotate(shapely.box(-0.0035, 0.0, 0.0035, 0.74 * radius_m), 72.0 * i, origin=(0, 0))
        for i in range(5)
    ]
    rim = shapely.Point(0, 0).buffer(0.75 * radius_m, quad_segs=9)
    rim = rim.difference(shapely.Point(0, 0).buffer(0.62 * radius_m, quad_segs=9))
    rim = shapely.union_all([rim, shapely.Point(0, 0).buffer(0.008, quad_segs=6), *spokes])
    for side in (1.0, -1.0):
        # The profile's x is r's x and its y is r's z, so that a tread points down.
        T_r_profile = np.array([[1, 0, 0, 0], [0, 0, side, 0], [0, -side, 0, radius_m], [0, 0, 0, 1]], float)
        for part, outline, inset_m in (("tyres", tyre, 0.0), ("rims", rim, 0.003)):
            z_m = 0.5 * (spec.track_m - width_m) + inset_m
            robot.extrude(part, outline, z_m, width_m - 2 * inset_m, T_r_profile)
        hub = [(0, 0), (0.005, 0), (0.0045, 0.0015), (0, 0.0015)]
        outside_m = 0.5 * (spec.track_m + width_m) - 0.0032
        robot.revolve("connectors", hub, 10, at(0, side * outside_m, radius_m, z_axis=(0, side, 0)))
        inner_m = 0.5 * (spec.track_m - width_m)
        centre_x_m = MOTOR_AXLE_M - 0.5 * MOTOR_M[0]
        robot.box("housings", MOTOR_M, (centre_x_m, side * (inner_m - 0.5 * MOTOR_M[1] - 0.001), radius_m))


def caster(robot: Burger) -> None:
    """The ball at the back in its housing."""
    spec = robot.spec.caster
    r = spec.radius_m
    arc = [(r * np.sin(a), r - r * np.cos(a)) for a in np.linspace(0.0, np.pi, 9)]
    robot.revolve("caster", arc, 16, at(spec.x_m, 0, 0))
    low_m = 0.55 * robot.spec.chassis.bottom_z_m
    housing = [(1.05 * r, low_m), (1.35 * r, low_m), (1.35 * r, 2.05 * r), (0, 2.05 * r)]
    robot.revolve("housings", housing, 16, at(spec.x_m, 0, 0))


def battery_and_opencr(robot: Burger) -> None:
    """The two lower layers; the OpenCR's switch is at its left back."""
    centre_m = robot.spec.chassis.centre_x_m
    battery_x_m = centre_m + 0.010  # clear of the caster's housing
    z_m = robot.tops_m[0] + 0.5 * BATTERY_M[2]
    robot.box("battery", BATTERY_M, (battery_x_m, 0, z_m))
    robot.box("label", (0.030, BATTERY_M[1] + 0.0006, 0.012), (battery_x_m - 0.02, 0, z_m))
    robot.box("label", (BATTERY_M[0] + 0.0006, 0.018, 0.010), (battery_x_m, 0, z_m))

    z_m = robot.tops_m[1] + BOARD_GAP_M
    robot.box("board_opencr", OPENCR_M, (centre_m, 0, z_m))
    top_m = z_m + 0.5 * OPENCR_M[2]
    robot.box("chips", (0.020, 0.020, 0.002), (centre_m + 0.01, 0.004, top_m + 0.001))
    for i in range(4):
        robot.box("connectors", (0.012, 0.005, 0.008), (centre_m + 0.044 - 0.019 * i, 0.033, top_m + 0.004))
        robot.box("chips", (0.011, 0.005, 0.009), (centre_m + 0.040 - 0.020 * i, -0.033, top_m + 0.0045))
    robot.box("switch", (0.013, 0.008, 0.010), (centre_m - 0.045, 0.022, top_m + 0.005))
    robot.box("connectors", (0.009, 0.012, 0.011), (centre_m - 0.047, -0.006, top_m + 0.0055))
    for x_m, y_m in ((-0.048, -0.0336), (-0.048, 0.0336), (0.048, -0.0336), (0.048, 0.0336)):
        robot.revolve("standoffs", BOARD_POST_M, 6, at(centre_m + x_m, y_m, robot.tops_m[1]))


def raspberry_pi(robot: Burger) -> None:
    """The third layer; the Pi's plugs look back, the lidar's USB board lies to its left."""
    centre_m = robot.spec.chassis.centre_x_m
    z_m = robot.tops_m[2] + BOARD_GAP_M
    pi_x_m = centre_m - 0.012
    robot.box("board_pi", PI_M, (pi_x_m, 0, z_m))
    top_m = z_m + 0.5 * PI_M[2]
    back_m = pi_x_m - 0.5 * PI_M[0]
    robot.box("connectors", (0.0213, 0.0160, 0.0135), (back_m + 0.0090, 0.0180, top_m + 0.00675))
    for y_m in (-0.0010, -0.0190):
        robot.box("connectors", (0.0171, 0.0131, 0.0155), (back_m + 0.0068, y_m, top_m + 0.00775))
        robot.box("switch", (0.0012, 0.0108, 0.0016), (back_m - 0.0018, y_m, top_m + 0.0045))
        robot.box("chips", (0.0008, 0.0105, 0.0050), (back_m - 0.0018, y_m, top_m + 0.0108))
    lds_y_m = 0.5 * PI_M[1] + 0.016  # the LDS's USB board, left of the Pi
    robot.box("board_lds", (0.030, 0.020, 0.0016), (centre_m - 0.004, lds_y_m, z_m))
    robot.box("connectors", (0.0075, 0.0056, 0.0030), (centre_m + 0.008, lds_y_m, z_m + 0.0023))
    robot.box("chips", (0.005, 0.012, 0.0060), (centre_m - 0.016, lds_y_m, z_m + 0.0038))
    robot.box("chips", (0.014, 0.014, 0.0024), (pi_x_m + 0.012, 0.002, top_m + 0.0012))
    robot.box("chips", (0.051, 0.005, 0.0085), (pi_x_m + 0.010, 0.0245, top_m + 0.00425))
    for x_m, y_m in ((-0.038, -0.024), (-0.038, 0.024), (0.038, -0.024), (0.038, 0.024)):
        robot.revolve("standoffs", BOARD_POST_M, 6, at(pi_x_m + x_m, y_m, robot.tops_m[2]))


def lidar(robot: Burger) -> None:
    """LDS-01: a base that is longer towards the back, where its motor is, and a turning head with a dome."""
    spec = robot.spec.lidar
    base_m = robot.spec.chassis.top_z_m
    top_m = robot.spec.size_m[2]
    body = shapely.Point(0, 0).buffer(LIDAR_BASE_RADIUS_M, quad_segs=10)
    motor = shapely.Point(LIDAR_BASE_RADIUS_M + 0.012 - LIDAR_LENGTH_M, 0).buffer(0.012, quad_segs=6)
    outline = affinity.translate(shapely.union_all([body, motor]).convex_hull, spec.x_m)
    robot.extrude("lidar_base", outline, base_m, 0.4 * LIDAR_BASE_M)
    robot.extrude("lidar_base", outline.buffer(-0.002), base_m, LIDAR_BASE_M)
    pulley_x_m = spec.x_m + LIDAR_BASE_RADIUS_M + 0.012 - LIDAR_LENGTH_M
    pulley = [(0.009, 0), (0.009, 0.003), (0.007, 0.004), (0, 0.004)]
    robot.revolve("lidar_head", pulley, 20, at(pulley_x_m, 0, base_m + LIDAR_BASE_M))

    low_m, r = base_m + LIDAR_BASE_M + 0.0008, spec.cap_radius_m
    below_m, above_m = spec.z_m - 0.0055, spec.z_m + 0.0045
    head = [(0, low_m), (0.86 * r, low_m), (0.93 * r, low_m + 0.001), (0.93 * r, below_m), (0, below_m)]
    rise_m = top_m - above_m - 0.0012
    dome = [(0, above_m), (0.93 * r, above_m)]
    dome += [(0.93 * r * np.cos(a) ** 0.4, top_m - rise_m * (1 - np.sin(a))) for a in np.linspace(0, 1.5, 7)]
    dome += [(0, top_m)]
    axis = at(spec.x_m, 0, 0)
    robot.revolve("lidar_head", head, 40, axis)
    robot.revolve("lidar_head", dome, 40, axis)
    window = [(0.90 * r, below_m), (0.90 * r, above_m)]
    robot.revolve("lidar_window", window, 40, axis)
    # The two eyes of the head, and the rib that holds its roof: they show which way it has turned.
    for y_m, radius_m in ((0.012, 0.0042), (-0.012, 0.0034)):
        eye = [(0, 0), (radius_m, 0), (radius_m, 0.0012), (0, 0.0012)]
        frame = at(spec.x_m + 0.84 * r, y_m, 0.5 * (below_m + above_m), z_axis=(1, 0, 0))
        robot.revolve("lenses", eye, 14, frame)
    rib = (0.004, 0.020, above_m - below_m)
    robot.box("lidar_head", rib, (spec.x_m - 0.88 * r, 0, 0.5 * (below_m + above_m)))


def camera(robot: Burger) -> None:
    """D435: its colour lens where the robot file puts the camera, its front flush with the plates."""
    x_m, y_m, z_m = robot.spec.camera.xyz_m
    front_m = robot.spec.chassis.centre_x_m + robot.spec.chassis.radius_m
    depth_m, width_m, height_m = CAMERA_M
    centre_y_m = y_m - CAMERA_COLOUR_Y_M
    half_m = 0.5 * height_m
    stadium = shapely.LineString([(half_m - 0.5 * width_m, 0), (0.5 * width_m - half_m, 0)])
    T_r_face = np.array([[0, 0, 1, 0], [1, 0, 0, centre_y_m], [0, 1, 0, z_m], [0, 0, 0, 1]], float)
    layers = (
        ("camera_body", half_m, front_m - depth_m, depth_m - 0.0016),
        ("camera_face", half_m - 0.0016, front_m - 0.004, 0.0034),
    )
    for part, radius_m, back_m, thick_m in layers:
        robot.extrude(part, stadium.buffer(radius_m, quad_segs=8), back_m, thick_m, T_r_face)
    for lens_y_m, radius_m in CAMERA_LENSES:
        face = at(front_m - 0.0006, centre_y_m + lens_y_m, z_m, z_axis=(1, 0, 0))
        ring = [(0.72 * radius_m, 0), (radius_m, 0), (radius_m, 0.0005), (0.72 * radius_m, 0.0005)]
        robot.revolve("connectors", [*ring, ring[0]], 20, face)
        glass = [(0.72 * radius_m, 0), (0.4 * radius_m, 0.0003), (0, 0.0004)]
        robot.revolve("lenses", glass, 20, face)
    gap_m = z_m - half_m - robot.tops_m[2]
    foot_m = (x_m - 0.5 * depth_m, centre_y_m, z_m - half_m - 0.5 * gap_m)
    robot.box("housings", (0.016, 0.030, gap_m), foot_m)


def burger_glb(spec: RobotSpec) -> bytes:
    """The robot's GLB."""
    robot = Burger(spec)
    for build in (plates, standoffs, wheels, caster, battery_and_opencr, raspberry_pi, lidar, camera):
        build(robot)
    return robot_glb(robot.parts())


def burger_mjcf(spec: RobotSpec) -> str:
    """The robot as the simulation has it, alone on a floor."""
    return scene_mjcf([], [spec], [SE2.identity()])


if __name__ == "__main__":
    burger = load_robot(str(HERE / "robot.yaml"))
    (HERE / "robot.glb").write_bytes(burger_glb(burger))
    (HERE / "robot.xml").write_text(burger_mjcf(burger))
