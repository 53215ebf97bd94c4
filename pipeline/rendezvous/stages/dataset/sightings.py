"""Rows of the dataset from an episode's record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rendezvous.evaluation.metrics import ghost_cells, pose_error
from rendezvous.exploration.records import Episode, Rendezvous, Snapshot
from rendezvous.exploration.rendezvous import Sighting
from rendezvous.floorplan.records import Floorplan
from rendezvous.geometry.occupancy_grid import overlap
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.geometry.wall_agreement import wall_agreement
from rendezvous.simulation.robot import RobotSpec


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeScene:
    """The place of an episode, and its robots."""

    plan: Floorplan
    # furniture, lidar_segments_m: each robot's world, which may be the same or differ.
    furniture: tuple[Sequence[Mapping[str, Any]], Sequence[Mapping[str, Any]]]  # rows of `SOLIDS_TYPE`
    density: float
    lidar_segments_m: tuple[Array, Array]  # (E, 4) the outlines in w of all that the lidar sees
    starts: tuple[SE2, SE2]  # the true start poses, which are the map frames
    robot: RobotSpec
    drive: str
    drawn: str = ""  # what was drawn for the episode, as `episode_id` has it after its name


def sighting_rows(
    scene: EpisodeScene, episode: Episode, *, episode_id: str, seed: int
) -> Iterator[dict[str, Any]]:
    """One row of `EXPLORE` per sighting: two for an event in which both robots see each other."""
    for number, event in enumerate(episode.events):
        ghosts = _ghosts(scene, event)
        for observer, sighting in enumerate(event.sightings):
            if sighting is None:
                continue
            event_id = f"{episode_id}-m{number}"
            yield {
                "pair_id": f"{event_id}-{observer}",
                "event_id": event_id,
                "episode_id": f"{episode_id}{scene.drawn}",
                "observer": observer,
                "plan_id": scene.plan.plan_id,
                "plan_digest": scene.plan.digest(),
                "seed": seed,
                "t_s": event.t_s,
                "drive": scene.drive,
                "furniture_density": scene.density,
                "furniture": scene.furniture[observer],
                **seen_columns(sighting, scene.robot, scene.robot.camera.T_r_c()),
                **pair_columns(scene.starts, event, observer, ghosts),
            }


def _ghosts(scene: EpisodeScene, event: Rendezvous) -> list[int]:
    """Number of cells in each robot's map that the other robot left."""
    masks = [
        ghost_cells(own.grid, own.T_w_r @ own.T_m_r.inverse(), segments_m, other.trajectory_w[:, 1:3])
        for own, other, segments_m in zip(
            event.snapshots, event.snapshots[::-1], scene.lidar_segments_m, strict=True
        )
    ]
    return [int(mask.sum()) for mask in masks]


def seen_columns(sighting: Sighting, robot: RobotSpec, T_r0_c: Array) -> dict[str, Any]:
    """What the camera at `T_r0_c` (4, 4) on robot 0 sees of robot 1; both are of this kind."""
    camera = robot.camera.intrinsics()
    return {
        "range_m": sighting.range_m,
        "bearing_rad": sighting.bearing_rad,
        "visible_fraction": sighting.visible_fraction,
        "image_width_px": camera.width_px,
        "image_height_px": camera.height_px,
        "K": camera.K(),
        "T_r0_c": T_r0_c,
        "robot": robot.name,
        "cuboid_size_m": robot.cuboid.size_m,
        "T_r1_o": robot.cuboid.T_r_o(),
    }


def pair_columns(
    starts: tuple[SE2, SE2], event: Rendezvous, observer: int, ghosts: Sequence[int]
) -> dict[str, Any]:
    """The two robots' maps and poses; robot 0 is the observer.

    Args:
        starts: the true start poses in w, which are the map frames.
        event: the rendezvous.
        observer: the robot of the event that becomes robot 0.
        ghosts: number of cells in each robot's map that the other one left.
    """
    order = (observer, 1 - observer)
    first, second = (event.snapshots[i] for i in order)
    T_w_m0, T_w_m1 = (starts[i] for i in order)
    T_r0_r1 = first.T_w_r.inverse() @ second.T_w_r
    T_m0_m1 = T_w_m0.inverse() @ T_w_m1
    T_m0_m1_local = first.T_m_r @ T_r0_r1 @ second.T_m_r.inverse()
    row = {
        "resolution_m": first.grid.resolution_m,
        "T_r0_r1_true": T_r0_r1.wrapped(),
        "T_m0_m1": T_m0_m1.wrapped(),
        "T_m0_m1_local": T_m0_m1_local.wrapped(),
        "overlap": overlap(first.grid, second.grid, T_m0_m1_local),
        "wall_agreement_local": wall_agreement(first.grid, second.grid, T_m0_m1_local).share,
        "wall_agreement": wall_agreement(first.grid, second.grid, T_m0_m1).share,
    }
    for i, robot in enumerate(order):
        row |= _robot(i, event.snapshots[robot], starts[robot])
        row[f"ghost_cells_{i}"] = ghosts[robot]
    return row


def _robot(i: int, snapshot: Snapshot, T_w_m: SE2) -> dict[str, Any]:
    T_m_r_true = T_w_m.inverse() @ snapshot.T_w_r
    slam, odometry = pose_error(snapshot.T_m_r, T_m_r_true), pose_error(snapshot.T_m_r_odometry, T_m_r_true)
    true_path = snapshot.trajectory_w.copy()
    true_path[:, 1:3] = T_w_m.inverse() @ true_path[:, 1:3]
    true_path[:, 3] -= T_w_m.yaw_rad
    return {
        f"map_{i}": snapshot.grid.png(),
        f"origin_{i}": snapshot.grid.T_m_g,
        f"T_w_m{i}": T_w_m.wrapped(),
        f"T_m{i}_r{i}": snapshot.T_m_r.wrapped(),
        f"T_m{i}_r{i}_true": T_m_r_true.wrapped(),
        f"T_m{i}_r{i}_odometry": snapshot.T_m_r_odometry.wrapped(),
        f"slam_position_error_{i}_m": slam.position_m,
        f"slam_heading_error_{i}_rad": slam.heading_rad,
        f"odometry_position_error_{i}_m": odometry.position_m,
        f"odometry_heading_error_{i}_rad": odometry.heading_rad,
        f"trajectory_{i}": snapshot.trajectory,
        f"trajectory_{i}_true": true_path,
        f"occupied_cells_{i}": int(snapshot.grid.occupied().sum()),
    }
