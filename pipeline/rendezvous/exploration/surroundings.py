"""A furnished plan for physics, lidar and camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rendezvous.floorplan.records import Floorplan, Solid
from rendezvous.floorplan.walls import SightObstacles, lidar_outline, sight_obstacles
from rendezvous.simulation.rays import RayScene, ray_scene
from rendezvous.simulation.robot import RobotSpec


@dataclass(frozen=True, slots=True, kw_only=True)
class Surroundings:
    """The world around the robots.

    Attributes:
        solids: all that they can run into.
        lidar_scene: all that their lidars see, at the height that both have in common.
        sight_obstacles: all that can hide one robot from the other's camera.
    """

    solids: tuple[Solid, ...]
    lidar_scene: RayScene
    sight_obstacles: SightObstacles


def furnished(
    plan: Floorplan, walls: Sequence[Solid], furniture: Sequence[Solid], robot: RobotSpec
) -> Surroundings:
    """The surroundings of such robots in a furnished plan."""
    segments_m, circles_m = lidar_outline(plan, furniture, height_m=robot.lidar.z_m)
    wall_height_m = max(wall.z1_m for wall in walls)
    return Surroundings(
        solids=(*walls, *in_the_way(furniture, robot)),
        lidar_scene=ray_scene(segments_m, circles_m),
        sight_obstacles=sight_obstacles(plan, furniture, wall_height_m=wall_height_m),
    )


def in_the_way(furniture: Sequence[Solid], robot: RobotSpec) -> tuple[Solid, ...]:
    """The furniture that the robot can run into: a table top above it would only slow physics down."""
    return tuple(solid for solid in furniture if solid.z0_m < robot.size_m[2])
