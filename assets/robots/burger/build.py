"""Builds `robot.glb`, the looks of a TurtleBot3 Burger with a RealSense D435, and its `robot.xml`.

python assets/robots/burger/build.py

Where sensors and wheels are comes from `robot.yaml`; the rest are the sizes and places of bought parts that
nothing but a picture needs, from the makers' drawings and data sheets (ROBOTIS: Burger, LDS-01, LDS-02,
OpenCR, XL430; Raspberry Pi 3; D435). Lengths [m] in the robot frame r: on the floor between the wheels, x
forward, y left, z up. A part's name begins with its kind, from which a variant of the robot knows what may
happen to it; see `assets/robots/README.md`.
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

PLASTIC = Material(base_colour_rgb=(0.022, 0.022, 0.024), roughness=0.5)
METAL = Material(base_colour_rgb=(0.66, 0.66, 0.68), metallic=0.85, roughness=0.35)

MATERIALS = {
    "battery": Material(base_colour_rgb=(0.02, 0.05, 0.30), roughness=0.45),
    "board.lds": Material(base_colour_rgb=(0.03, 0.05, 0.04), roughness=0.5),
    "board.opencr": Material(base_colour_rgb=(0.01, 0.06, 0.22), roughness=0.5),
    "board.pi": Material(base_colour_rgb=(0.01, 0.18, 0.05), roughness=0.5),
    "bracket": PLASTIC,
    "cable.battery": Material(base_colour_rgb=(0.50, 0.01, 0.01), roughness=0.5),
    "cable": Material(base_colour_rgb=(0.015, 0.015, 0.015), roughness=0.5),
    "camera.d435.body": Material(base_colour_rgb=(0.62, 0.63, 0.65), metallic=0.7, roughness=0.35),
    "camera.d435.face": Material(base_colour_rgb=(0.012, 0.012, 0.014), roughness=0.12),
    "camera.d435.foot": PLASTIC,
    "caster.ball": METAL,
    "caster.housing": PLASTIC,
    "chip": Material(base_colour_rgb=(0.02, 0.02, 0.02), roughness=0.4),
    "lidar": Material(base_colour_rgb=(0.030, 0.030, 0.034), roughness=0.45),
    "lidar.lds02.window": Material(base_colour_rgb=(0.05, 0.012, 0.016), roughness=0.08),
    "motor": Material(base_colour_rgb=(0.030, 0.030, 0.032), roughness=0.5),
    "plate": Material(base_colour_rgb=(0.028, 0.028, 0.030), roughness=0.6),
    "plug": METAL,
    "plug.switch": Material(base_colour_rgb=(0.55, 0.02, 0.02), roughness=0.4),
    "post": Material(base_colour_rgb=(0.55, 0.55, 0.57), metallic=0.8, roughness=0.35),
    "rim": Material(base_colour_rgb=(0.026, 0.026, 0.028), roughness=0.5),
    "screw": METAL,
    "sticker": Material(base_colour_rgb=(0.75, 0.62, 0.30), roughness=0.5),
    "tyre": Material(base_colour_rgb=(0.014, 0.014, 0.015), roughness=0.9),
}

PLATE_M = 0.009
UNDERSIDES_M = (0.010, 0.0475, 0.095, 0.1425)
TOPS_M = tuple(z + PLATE_M for z in UNDERSIDES_M)
PLATE_CORNER_M = ((0.064, 0.043), (0.050, 0.0553), (0.045, 0.064))
"""One cut corner of a plate about its centre; the others follow by turning."""
TAB_M, TAB_HALF_M = 0.0048, 0.0060  # a plate's edge has four tabs and notches, 12 and 24 mm from the middle
HOLE_PITCH_M, HOLE_RADIUS_M = 0.012, 0.0016

POSTS_XY_M = (
    ((0.064, 0.024), (-0.064, 0.024)),
    ((0.064, 0.012), (-0.024, 0.064)),
    ((0.064, 0.024), (-0.064, 0.024), (0.024, 0.064)),
)
"""Posts of the three layers about the plates' centre, each with its mirror image."""
POST_RADIUS_M = 0.0029

MOTOR_X_M, MOTOR_Y_M, MOTOR_Z_M = (-0.0352, 0.0112), (0.035, 0.069), (0.019, 0.0475)
BATTERY_X_M, BATTERY_Y_M, BATTERY_Z_M = (-0.0773, 0.008), (-0.0175, 0.0175), (0.019, 0.0465)
OPENCR_M, OPENCR_Z_M = (0.105, 0.075, 0.0017), 0.0665
PI_M, PI_X_M, PI_Z_M = (0.056, 0.085, 0.0016), -0.064, 0.1142
SUPPORT_M = 0.010

LDS_DECK_M = (
    (0.0288, 0.007), (0.0205, 0.017), (0.009, 0.023), (0.004, 0.0230), (0.001, 0.0215), (-0.001, 0.028),
    (-0.004, 0.0285), (-0.016, 0.0315), (-0.032, 0.033), (-0.049, 0.0315), (-0.052, 0.0285),
    (-0.060, 0.0275), (-0.0635, 0.025), (-0.065, 0.004),
)  # fmt: skip
"""Outline of LDS-01's deck from front to back, left half."""
LDS_MOTOR_X_M, LDS_MOTOR_RADIUS_M = 0.0145, 0.0138
LDS_HEAD_RADIUS_M, LDS_HEAD_FLAT_M = 0.0318, 0.0290

CAMERA_M = (0.025, 0.090, 0.025)  # D435
CAMERA_COLOUR_Y_M = 0.0325  # its colour lens, left of the body's middle


class Burger(SolidParts):
    """The robot's parts as they are collected."""

    def __init__(self, spec: RobotSpec) -> None:
        super().__init__(MATERIALS)
        self.spec = spec
        self.centre_m = spec.chassis.centre_x_m

    def block(self, part: str, x_m: Span, y_m: Span, z_m: Span) -> None:
        """A block between coordinates in r."""
        low, high = np.array([x_m, y_m, z_m]).T
        self.box(part, tuple(high - low), tuple(0.5 * (low + high)))

    def pair(self, part: str, x_m: Span, y_m: Span, z_m: Span) -> None:
        """A block and its mirror image on the right."""
        self.block(part, x_m, y_m, z_m)
        self.block(part, x_m, (-y_m[1], -y_m[0]), z_m)

    def rod(self, part: str, xy_m: Point, z_m: Span, radius_m: float, *, sides: int = 6) -> None:
        """An upright rod."""
        profile = [(0.0, z_m[0]), (radius_m, z_m[0]), (radius_m, z_m[1]), (0.0, z_m[1])]
        self.revolve(part, profile, sides, at(*xy_m, 0.0))


Span = tuple[float, float]
Point = tuple[float, float]


def plate_outline() -> shapely.Polygon:
    """A waffle plate about its centre: two halves make a square with cut corners, four tabs and notches."""
    corner = np.array(PLATE_CORNER_M)
    turns = [np.array([[c, -s], [s, c]]) for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    outline = shapely.Polygon(np.concatenate([corner @ turn.T for turn in turns]))
    tab = shapely.Polygon([(-1.0, -1.35), (-1.0, 1.35), (0.0, 1.0), (1.0, 0.55), (1.0, -0.55), (0.0, -1.0)])
    for y_m, out in ((0.024, 1), (0.012, -1), (-0.012, 1), (-0.024, -1)):
        shape = affinity.affine_transform(tab, [out * TAB_M, 0.0, 0.0, TAB_HALF_M, 0.064, y_m])
        for quarter_turns in range(4):
            turned = affinity.rotate(shape, 90.0 * quarter_turns, origin=(0.0, 0.0))
            outline = outline.union(turned) if out > 0 else outline.difference(turned)
    return outline


def plates(robot: Burger) -> None:
    """Four waffle plates; the lowest is the wrong way up."""
    outline = plate_outline()
    steps = (np.arange(-5, 5) + 0.5) * HOLE_PITCH_M
    xy_m = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    holes = shapely.buffer(shapely.points(xy_m), HOLE_RADIUS_M, quad_segs=1)
    waffle = outline.difference(shapely.union_all(holes[shapely.contains(outline.buffer(-0.006), holes)]))
    for layer, z_m in enumerate(UNDERSIDES_M):
        shape = affinity.scale(waffle, yfact=-1.0 if layer else 1.0, origin=(0.0, 0.0))
        robot.extrude(f"plate.{layer}", affinity.translate(shape, robot.centre_m), z_m, PLATE_M)


def posts(robot: Burger) -> None:
    """Six-sided posts, each a part of its own, with the ends of their screws."""
    for layer, places in enumerate(POSTS_XY_M):
        for x_m, y_m in places:
            for side, hand in ((1.0, "left"), (-1.0, "right")):
                end = "front" if x_m > 0.05 else "back" if x_m < -0.05 else "side"
                xy_m = (robot.centre_m + x_m, side * y_m)
                z_m = (TOPS_M[layer] - 0.003, UNDERSIDES_M[layer + 1] + 0.003)
                robot.rod(f"post.{layer}.{end}_{hand}", xy_m, z_m, POST_RADIUS_M)
                robot.rod(
                    f"screw.{layer}", xy_m, (TOPS_M[layer + 1] - 0.001, TOPS_M[layer + 1] + 0.0012), 0.0026
                )


def wheels(robot: Burger) -> None:
    """Tyres with treads; rims are deep dishes with a cross of four holed spokes at their inner side."""
    spec = robot.spec.wheels
    radius_m, width_m = spec.radius_m, spec.width_m
    angles = np.linspace(0.0, 2.0 * np.pi, 4 * 30, endpoint=False)
    # Two of four points of a tread are on the full radius, one of them where the tyre touches the floor.
    radii_m = np.where(np.arange(2, 122) % 4 < 2, radius_m, radius_m - 0.0010)
    tread = shapely.Polygon(np.column_stack([radii_m * np.cos(angles), radii_m * np.sin(angles)]))
    tyre = tread.difference(shapely.Point(0, 0).buffer(0.026, quad_segs=9))
    dish = shapely.Point(0, 0).buffer(0.0262, quad_segs=9)
    hoop = dish.difference(shapely.Point(0, 0).buffer(0.0225, quad_segs=9))
    cross = shapely.union_all(
        [shapely.box(-0.0055, -0.0245, 0.0055, 0.0245), shapely.box(-0.0245, -0.0055, 0.0245, 0.0055)]
    )
    cross = cross.buffer(0.005, quad_segs=2).buffer(-0.005).union(hoop)
    cross = cross.difference(
        shapely.union_all(
            [
                shapely.Point(x, y).buffer(0.0033, quad_segs=2)
                for x, y in ((0, 0), (0.0117, 0), (-0.0117, 0), (0, 0.0117), (0, -0.0117))
            ]
        )
    )
    for side in (1.0, -1.0):
        # The profile's x is r's x and its y is r's z, so that a tread points down.
        T_r_profile = np.array([[1, 0, 0, 0], [0, 0, side, 0], [0, -side, 0, radius_m], [0, 0, 0, 1]], float)
        inner_m = 0.5 * (spec.track_m - width_m)
        robot.extrude("tyre", tyre, inner_m, width_m, T_r_profile)
        robot.extrude("rim", hoop, inner_m + 0.0005, width_m - 0.003, T_r_profile)
        robot.extrude("rim", cross, inner_m + 0.0005, 0.0045, T_r_profile)
        horn = [(0, 0), (0.0102, 0), (0.0102, 0.0025), (0, 0.0025)]
        robot.revolve("motor", horn, 16, at(0, side * 0.0685, radius_m, z_axis=(0, side, 0)))
    robot.pair("motor", MOTOR_X_M, MOTOR_Y_M, MOTOR_Z_M)


def caster(robot: Burger) -> None:
    """The small ball at the back in its flat housing."""
    x_m, r = robot.spec.caster.x_m, 0.0048
    arc = [(r * np.sin(a), r - r * np.cos(a)) for a in np.linspace(0.0, np.pi, 9)]
    robot.revolve("caster.ball", arc, 16, at(x_m, 0, 0))
    housing = shapely.LineString([(x_m - 0.006, 0), (x_m + 0.006, 0)]).buffer(0.009, quad_segs=5)
    robot.extrude("caster.housing", housing, 0.0035, UNDERSIDES_M[0] - 0.0035)


def battery_and_opencr(robot: Burger) -> None:
    """The two lower layers: the battery between brackets, and the OpenCR on four supports."""
    c = robot.centre_m
    robot.block("battery", BATTERY_X_M, BATTERY_Y_M, BATTERY_Z_M)
    robot.block("sticker.battery", (-0.060, -0.015), (-0.0178, 0.0178), (0.026, 0.041))
    robot.pair("bracket", (-0.044, -0.032), (0.0178, 0.033), (0.019, 0.043))
    robot.pair("bracket", (0.008, 0.032), (0.003, 0.015), (0.019, 0.034))
    robot.block("bracket", (-0.090, -0.078), (-0.009, 0.015), (0.019, 0.034))
    robot.block("plug.battery", (-0.0834, -0.0775), (-0.0137, -0.0055), (0.0274, 0.0381))
    robot.block("plug.motor", (-0.0558, -0.0385), (0.0225, 0.0301), (0.035, 0.0475))

    x_m, y_m, thick_m = OPENCR_M
    for sx in (1.0, -1.0):
        for sy in (1.0, -1.0):
            supports(robot, [(c + sx * 0.048, sy * 0.032)], [(c + sx * 0.0335, sy * 0.011)], TOPS_M[1])
    robot.block(
        "board.opencr", (c - x_m / 2, c + x_m / 2), (-y_m / 2, y_m / 2), (OPENCR_Z_M, OPENCR_Z_M + thick_m)
    )
    top_m = OPENCR_Z_M + thick_m
    robot.block("chip.opencr", (c, c + 0.020), (-0.006, 0.014), (top_m, top_m + 0.002))
    for i in range(4):
        robot.block(
            "plug.opencr",
            (c + 0.038 - 0.019 * i, c + 0.048 - 0.019 * i),
            (0.031, 0.036),
            (top_m, top_m + 0.005),
        )
        robot.block(
            "chip.opencr",
            (c + 0.034 - 0.020 * i, c + 0.045 - 0.020 * i),
            (-0.036, -0.031),
            (top_m, top_m + 0.0065),
        )
    robot.block("plug.switch", (c - 0.050, c - 0.040), (0.018, 0.026), (top_m, top_m + 0.008))
    robot.block("plug.opencr", (c - 0.0515, c - 0.043), (-0.012, 0.000), (top_m, top_m + 0.009))


def supports(robot: Burger, outer_m: list[Point], inner_m: list[Point], z_m: float) -> None:
    """Slotted bars on a plate, from the hole that holds each to its outer end, as high as boards stand."""
    for a, b in zip(outer_m, inner_m, strict=True):
        bar = shapely.LineString([a, b]).buffer(0.0050, quad_segs=1)
        robot.extrude("bracket", bar, z_m, 0.0040)
        robot.rod("bracket", a, (z_m, z_m + SUPPORT_M), 0.0030)


def raspberry_pi(robot: Burger) -> None:
    """The third layer: the Pi across at the back, its plugs to the right, and the lidar's USB board."""
    x_m, y_m, thick_m = PI_M
    for sx, sy in ((1.0, 0.039), (-1.0, 0.039), (1.0, -0.019), (-1.0, -0.019)):
        x = PI_X_M + sx * 0.0245
        supports(robot, [(x, sy)], [(x + sx * 0.004, sy - 0.022)], TOPS_M[2])
    robot.block(
        "board.pi", (PI_X_M - x_m / 2, PI_X_M + x_m / 2), (-y_m / 2, y_m / 2), (PI_Z_M, PI_Z_M + thick_m)
    )
    top_m = PI_Z_M + thick_m
    right_m = -0.5 * y_m
    # USB, USB and Ethernet at the right end; GPIO pins along the front edge.
    for part, offset_m, wide_m, deep_m, high_m in (
        ("plug.usb", -0.019, 0.0131, 0.0171, 0.0155),
        ("plug.usb", -0.001, 0.0131, 0.0171, 0.0155),
        ("plug.ethernet", 0.018, 0.0160, 0.0213, 0.0135),
    ):
        x = PI_X_M + offset_m
        robot.block(
            part,
            (x - wide_m / 2, x + wide_m / 2),
            (right_m - 0.0015, right_m - 0.0015 + deep_m),
            (top_m, top_m + high_m),
        )
        for z in (0.0030, 0.0095):
            robot.block(
                "chip.ports",
                (x - 0.4 * wide_m, x + 0.4 * wide_m),
                (right_m - 0.0020, right_m),
                (top_m + z, top_m + z + 0.003),
            )
    robot.block("chip.pi", (PI_X_M - 0.007, PI_X_M + 0.007), (0.005, 0.019), (top_m, top_m + 0.0024))
    robot.block("chip.pi", (PI_X_M - 0.0275, PI_X_M - 0.0225), (-0.012, 0.039), (top_m, top_m + 0.0085))
    robot.block("plug.hdmi", (PI_X_M + 0.018, PI_X_M + 0.0285), (0.003, 0.018), (top_m, top_m + 0.0065))
    robot.block("bracket", (-0.020, -0.002), (-0.009, 0.009), (TOPS_M[2], TOPS_M[2] + 0.003))
    robot.block("board.lds", (-0.020, -0.002), (-0.015, 0.015), (TOPS_M[2] + 0.003, TOPS_M[2] + 0.0051))
    robot.block("plug.lds", (-0.0169, -0.0051), (0.0095, 0.0150), (TOPS_M[2] + 0.002, TOPS_M[2] + 0.0077))
    robot.block("plug.lds", (-0.0150, -0.0070), (-0.0154, -0.010), (TOPS_M[2] + 0.004, TOPS_M[2] + 0.0069))


def lidar_supports(robot: Burger) -> None:
    """Four slotted bars that carry the lidar's ears."""
    for side in (1.0, -1.0):
        for ear, hole, end in (
            ((0.003, 0.025), (-0.017, 0.018), (-0.024, 0.016)),
            ((-0.054, 0.031), (-0.047, 0.018), (-0.040, 0.0065)),
        ):
            a, b = (ear[0], side * ear[1]), (end[0], side * end[1])
            bar = shapely.LineString([a, (*hole[:1], side * hole[1]), b]).buffer(0.0045, quad_segs=1)
            robot.extrude("bracket.lidar", bar, TOPS_M[3], 0.0035)
            robot.rod("bracket.lidar", a, (TOPS_M[3], TOPS_M[3] + SUPPORT_M), 0.0045)
            robot.rod("screw.lidar", a, (TOPS_M[3] + SUPPORT_M, 0.1722), 0.0026)


def lds_01(robot: Burger) -> None:
    """A deck with the motor at the FRONT and a turning head that is flat on one side and cut at the back."""
    x_m = robot.spec.lidar.x_m
    left = np.array(LDS_DECK_M)
    deck = shapely.Polygon(np.concatenate([left, left[::-1] * [1.0, -1.0]]))
    for x, y in ((-0.0045, 0.0272), (-0.0545, 0.0305)):
        deck = deck.union(shapely.MultiPoint([(x, y), (x, -y)]).buffer(0.0038, quad_segs=2))
    name = "lidar.lds01"
    robot.extrude(f"{name}.deck", deck, 0.1622, 0.0040)
    robot.extrude(f"{name}.deck", deck.difference(deck.buffer(-0.0025)), 0.1622, 0.0095)
    robot.rod(f"{name}.deck", (LDS_MOTOR_X_M, 0.0), (0.1518, 0.1630), LDS_MOTOR_RADIUS_M, sides=12)
    robot.rod(f"{name}.deck", (LDS_MOTOR_X_M, 0.0), (0.1660, 0.1700), 0.0070, sides=12)
    robot.rod(f"{name}.deck", (x_m, 0.0), (0.1602, 0.1722), 0.0180, sides=20)
    robot.rod(f"{name}.deck", (x_m, 0.0), (0.1650, 0.1722), 0.0285, sides=24)
    head = shapely.Point(0, 0).buffer(LDS_HEAD_RADIUS_M, quad_segs=7)
    head = head.intersection(shapely.box(-1, -1, LDS_HEAD_FLAT_M, 1))
    cap = head.intersection(shapely.box(-0.0178, -1, 1, 1)).union(shapely.box(-0.031, -0.004, 0.0, 0.004))
    head, cap = (affinity.translate(shape, x_m) for shape in (head, cap))
    robot.extrude(f"{name}.head", head, 0.1722, 0.0153)
    robot.extrude(f"{name}.head", cap, 0.1875, 0.0035)


def lds_02(robot: Burger) -> None:
    """A flatter base with the motor at the front, and a round head with a glossy band and a lip."""
    x_m, r = robot.spec.lidar.x_m, 0.5 * 0.070
    name = "lidar.lds02"
    base = shapely.union_all(
        [shapely.Point(x_m, 0).buffer(r, quad_segs=8), shapely.Point(0.0095, 0).buffer(0.0135, quad_segs=6)]
    ).convex_hull
    robot.extrude(f"{name}.deck", base, 0.1600, 0.0070)
    robot.extrude(f"{name}.deck", base.buffer(-0.003), 0.1518, 0.0085)
    axis = at(x_m, 0, 0)
    robot.revolve(
        f"{name}.head",
        [(0, 0.1670), (0.94 * r, 0.1670), (0.97 * r, 0.1690), (0.97 * r, 0.1740), (0, 0.1740)],
        32,
        axis,
    )
    robot.revolve(
        f"{name}.window", [(0, 0.1740), (0.93 * r, 0.1740), (0.93 * r, 0.1850), (0, 0.1850)], 32, axis
    )
    robot.revolve(
        f"{name}.head",
        [(0, 0.1850), (0.97 * r, 0.1850), (0.97 * r, 0.1895), (0.88 * r, 0.1915), (0, 0.1915)],
        32,
        axis,
    )


def camera(robot: Burger) -> None:
    """D435: a bright shell with one plain dark face; its colour lens where the robot file puts the camera."""
    x_m, y_m, z_m = robot.spec.camera.xyz_m
    front_m = robot.centre_m + robot.spec.chassis.radius_m
    depth_m, width_m, height_m = CAMERA_M
    centre_y_m = y_m - CAMERA_COLOUR_Y_M
    half_m = 0.5 * height_m
    stadium = shapely.LineString([(half_m - 0.5 * width_m, 0), (0.5 * width_m - half_m, 0)])
    T_r_face = np.array([[0, 0, 1, 0], [1, 0, 0, centre_y_m], [0, 1, 0, z_m], [0, 0, 0, 1]], float)
    for part, radius_m, back_m, thick_m in (
        ("camera.d435.body", half_m - 0.0025, front_m - depth_m, 0.004),
        ("camera.d435.body", half_m, front_m - depth_m + 0.004, depth_m - 0.006),
        ("camera.d435.body", half_m - 0.0010, front_m - 0.002, 0.0016),
        ("camera.d435.face", half_m - 0.0030, front_m - 0.003, 0.0029),
    ):
        robot.extrude(part, stadium.buffer(radius_m, quad_segs=8), back_m, thick_m, T_r_face)
    foot_x_m = x_m - 0.5 * depth_m
    robot.block(
        "camera.d435.foot",
        (foot_x_m - 0.008, foot_x_m + 0.008),
        (centre_y_m - 0.009, centre_y_m + 0.009),
        (TOPS_M[2], z_m - half_m + 0.001),
    )


WIRES = {
    "cable.battery": "-80 -10 34, -94 -12 36, -98.5 -14 52, -92 -12 70, -78 -8 74",
    "cable.battery_black": "-80 -6 34, -90 -4 40, -92 -2 56, -88 -4 68, -78 -4 73",
    "cable.camera": "13 -40 122, -4 -52 126, -30 -58 124, -50 -60 122, -64 -46 124",
    "cable.lidar": "6 12 154, 12 20 138, 4 20 118, -8 16 109",
    "cable.lds_usb": "-11 -16 108, -12 -34 112, -30 -50 118, -48 -46 124",
    "cable.motor_left": "-30 46 47.5, -40 50 62, -30 44 74, -20 36 73",
    "cable.motor_right": "-30 -46 47.5, -36 -52 62, -20 -44 76, -4 -36 74",
    "cable.pi_power": "-36 30 118, -22 40 112, -16 46 90, -30 38 74",
}
"""Points of wires as they hang [mm]; each is a part of its own, so that a variant can have other ones."""

WIRE_RADIUS_M = 0.0013


def cables(robot: Burger) -> None:
    """Wires between battery, boards, motors and sensors."""
    for part, points_mm in WIRES.items():
        points_m = [tuple(1e-3 * float(value) for value in point.split()) for point in points_mm.split(",")]
        robot.tube(part, np.array(points_m), WIRE_RADIUS_M)


def burger_glb(spec: RobotSpec) -> bytes:
    """The robot's GLB."""
    robot = Burger(spec)
    for build in (
        plates,
        posts,
        wheels,
        caster,
        battery_and_opencr,
        raspberry_pi,
        lidar_supports,
        lds_01,
        lds_02,
        camera,
        cables,
    ):
        build(robot)
    return robot_glb(robot.parts())


def burger_mjcf(spec: RobotSpec) -> str:
    """The robot as the simulation has it, alone on a floor."""
    return scene_mjcf([], [spec], [SE2.identity()])


if __name__ == "__main__":
    burger = load_robot(str(HERE / "robot.yaml"))
    (HERE / "robot.glb").write_bytes(burger_glb(burger))
    (HERE / "robot.xml").write_text(burger_mjcf(burger))
