"""Poses of two robots in a furnished plan, drawn at random so that one sees the other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from rendezvous.errors import FloorplanError
from rendezvous.floorplan.records import Floorplan, Shape, Solid
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.rendering.draws import PoseDraws
from rendezvous.simulation.robot import RobotSpec

BATCH = 256
DRAWS = 60
LOW_M = 0.3  # solids that start lower occupy the floor; others, as a table top, leave room underneath


@dataclass(frozen=True, slots=True, kw_only=True)
class FurnishedPlan:
    """A plan with furniture, prepared for drawing poses in it by `furnished_plan`."""

    plan: Floorplan  # the floor plan
    furniture: tuple[Solid, ...]  # its solids
    wall_height_m: float  # height of walls and ceiling
    floor: shapely.Geometry  # floor without furniture on it [m]
    edge: shapely.Geometry  # boundary of that floor [m]
    clear: shapely.Geometry  # area through which a line of sight at a robot's height may pass [m]

    def stands(self, xy_m: Array, *, radius_m: float) -> NDArray[np.bool_]:
        """(N,) whether a circle of this radius about each of (N, 2) [m] lies on free floor."""
        inside = shapely.contains_xy(self.floor, xy_m)
        return inside & ~shapely.dwithin(self.edge, shapely.points(xy_m), radius_m)


def furnished_plan(plan: Floorplan, furniture: Sequence[Solid], *, wall_height_m: float) -> FurnishedPlan:
    """Subtract the furniture's footprints from the floor: once per furnishing, for all its pictures."""
    space = plan.free_space()
    low = shapely.union_all([_footprint(solid) for solid in furniture if solid.z0_m < LOW_M])
    floor = space.difference(low)
    # Legs are too thin to block the view.
    wide = [s for s in furniture if s.z0_m < LOW_M and max(s.half_x_m, s.half_y_m) > 0.05]
    clear = space.difference(shapely.union_all([_footprint(solid) for solid in wide]))
    edge = floor.boundary
    shapely.prepare([floor, edge, clear])
    return FurnishedPlan(
        plan=plan,
        furniture=tuple(furniture),
        wall_height_m=wall_height_m,
        floor=floor,
        edge=edge,
        clear=clear,
    )


def _footprint(solid: Solid) -> shapely.Geometry:
    if solid.shape is Shape.CYLINDER:
        return shapely.Point(solid.x_m, solid.y_m).buffer(solid.half_x_m)
    return shapely.Polygon(solid.corners_m())


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotPoses:
    """Poses on the floor of the observer and of the robot that it may see; None if that is elsewhere."""

    T_w_r0: SE2
    T_w_r1: SE2 | None


def draw_robot_poses(
    rng: np.random.Generator,
    place: FurnishedPlan,
    observer: RobotSpec,
    seen: RobotSpec,
    draws: PoseDraws,
    *,
    absent: bool,
) -> RobotPoses:
    """Poses at a distance uniform within the range, as far as rooms allow, and any heading.

    The robot seen is anywhere across the image, or in one of five at its edge, partly outside; a wall or
    cupboard may hide part of it but not all.

    Args:
        rng: draws the poses.
        place: the furnished plan.
        observer, seen: robots 0 and 1.
        draws: holds the range of distances.
        absent: draw the observer's pose alone.

    Raises:
        FloorplanError: there is no room for two robots.
    """
    for _ in range(DRAWS):
        range_m, column_px = _range_and_column(rng, observer, seen, draws)
        poses_0 = _anywhere(rng, place, observer)
        if absent and len(poses_0):
            return RobotPoses(T_w_r0=SE2.from_array(poses_0[0]), T_w_r1=None)
        centres_m = _seen_centres(poses_0, observer, seen, range_m, column_px)
        headings_rad = rng.uniform(-math.pi, math.pi, size=len(poses_0))
        c, s = np.cos(headings_rad), np.sin(headings_rad)
        dx_m, dy_m, _ = seen.cuboid.centre_m
        origins_m = centres_m - np.stack([c * dx_m - s * dy_m, s * dx_m + c * dy_m], axis=1)
        good = place.stands(origins_m, radius_m=seen.radius_m)
        good &= _in_sight(place, poses_0, centres_m, observer, seen)
        good &= np.hypot(*(origins_m - poses_0[:, :2]).T) > observer.radius_m + seen.radius_m
        for i in np.flatnonzero(good)[:1]:
            T_w_r1 = SE2.from_array([*origins_m[i], headings_rad[i]])
            return RobotPoses(T_w_r0=SE2.from_array(poses_0[i]), T_w_r1=T_w_r1)
    raise FloorplanError(
        f"{place.plan.plan_id}: no place for two robots in sight of each other in {DRAWS * BATCH} draws; "
        "a plan needs a free patch of half a metre"
    )


def _range_and_column(
    rng: np.random.Generator, observer: RobotSpec, seen: RobotSpec, draws: PoseDraws
) -> tuple[float, float]:
    """Distance [m] and image column [px] of the centre of the robot seen."""
    camera = observer.camera
    range_m = float(rng.uniform(draws.min_range_m, draws.max_range_m))
    if rng.random() < 0.8:
        return range_m, float(rng.uniform(0.0, camera.width_px))
    half_px = 0.5 * seen.size_m[1] * camera.fx_px / range_m
    edge_px = float(rng.choice([0.0, camera.width_px]))
    return range_m, edge_px + float(rng.uniform(-0.75, 0.75)) * half_px


def _anywhere(rng: np.random.Generator, place: FurnishedPlan, robot: RobotSpec) -> Array:
    """(N, 3) x [m], y [m], yaw [rad], uniform over the poses at which a robot can stand."""
    low, high = place.plan.outline_m.min(axis=0), place.plan.outline_m.max(axis=0)
    xy_m = rng.uniform(low, high, size=(BATCH, 2))
    yaw_rad = rng.uniform(-math.pi, math.pi, size=BATCH)
    return np.column_stack([xy_m, yaw_rad])[place.stands(xy_m, radius_m=robot.radius_m)]


def _seen_centres(
    poses_0: Array, observer: RobotSpec, seen: RobotSpec, range_m: float, column_px: float
) -> Array:
    """(N, 2) [m] in w: centre of the robot seen, for each pose of the observer."""
    camera = observer.camera
    rise_m = camera.xyz_m[2] - seen.cuboid.centre_m[2]
    away_m = math.sqrt(max(range_m**2 - rise_m**2, 0.0))
    bearing_rad = poses_0[:, 2] + camera.rpy_rad[2] - math.atan2(column_px - camera.cx_px, camera.fx_px)
    return _camera_places(poses_0, observer) + away_m * _direction(bearing_rad)


def _camera_places(poses_0: Array, observer: RobotSpec) -> Array:
    forward_m, left_m, _ = observer.camera.xyz_m
    yaw_rad = poses_0[:, 2]
    return poses_0[:, :2] + forward_m * _direction(yaw_rad) + left_m * _direction(yaw_rad + 0.5 * math.pi)


def _direction(angle_rad: Array) -> Array:
    return np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=1)


def _in_sight(
    place: FurnishedPlan, poses_0: Array, centres_m: Array, observer: RobotSpec, seen: RobotSpec
) -> NDArray[np.bool_]:
    """(N,) whether the view is clear to at least one of two points, left and right on the robot."""
    eyes_m = _camera_places(poses_0, observer)
    away = centres_m - eyes_m
    aside = np.stack([-away[:, 1], away[:, 0]], axis=1) / np.linalg.norm(away, axis=1, keepdims=True)
    visible = np.zeros(len(poses_0), np.bool_)
    for offset_m in (-0.3 * seen.size_m[1], 0.3 * seen.size_m[1]):
        lines = shapely.linestrings(np.stack([eyes_m, centres_m + offset_m * aside], axis=1))
        visible |= shapely.covers(place.clear, lines)
    return visible
