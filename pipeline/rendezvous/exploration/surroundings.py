"""A furnished plan as physics, lidar and camera meet it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rendezvous.exploration.rendezvous import SightObstacles
from rendezvous.floorplan.records import Floorplan, Solid
from rendezvous.floorplan.walls import lidar_outline, sight_obstacles
from rendezvous.simulation.rays import RayScene, ray_scene
from rendezvous.simulation.robot import RobotSpec


@dataclass(frozen=True, slots=True, kw_only=True)
class Surroundings:
    """What surrounds the robots.

    Attributes:
        solids: what they can run into.
        lidar_scene: what their lidars see; both robots have the same lidar height.
        sight_obstacles: what their cameras see.
    """

    solids: tuple[Solid, ...]
    lidar_scene: RayScene
    sight_obstacles: SightObstacles


def furnished(
    plan: Floorplan, walls: Sequence[Solid], furniture: Sequence[Solid], robot: RobotSpec
) -> Surroundings:
    """Put plan, wall boxes and furniture together for a robot of this height."""
    segments_m, circles_m = lidar_outline(plan, furniture, height_m=robot.lidar.z_m)
    wall_height_m = max(wall.z1_m for wall in walls)
    sides_m, bottoms_m, tops_m, cylinders_m = sight_obstacles(plan, furniture, wall_height_m=wall_height_m)
    return Surroundings(
        solids=(*walls, *in_the_way(furniture, robot)),
        lidar_scene=ray_scene(segments_m, circles_m),
        sight_obstacles=SightObstacles(
            segments_m=sides_m, bottoms_m=bottoms_m, tops_m=tops_m, circles_m=cylinders_m
        ),
    )


def in_the_way(furniture: Sequence[Solid], robot: RobotSpec) -> tuple[Solid, ...]:
    """What the robot can run into: a table top above it only costs time in physics."""
    return tuple(solid for solid in furniture if solid.z0_m < robot.size_m[2])
