"""One episode: two robots explore a furnished plan until they have met often enough."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rendezvous.compiled import njit
from rendezvous.exploration.explorer import Explorer
from rendezvous.exploration.records import Episode, EpisodeParameters, Rendezvous, Snapshot
from rendezvous.exploration.rendezvous import Sighting, sight
from rendezvous.floorplan.records import Floorplan, Solid
from rendezvous.floorplan.walls import SightObstacles, lidar_outline, sight_obstacles
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.simulation.drive import TICK_S, Encoder, Physics
from rendezvous.simulation.rays import RayScene, cast_rays, ray_scene
from rendezvous.simulation.robot import RobotSpec, beam_bearings, noisy_ranges
from rendezvous.slam.slam import last_part


@dataclass(frozen=True, slots=True, kw_only=True)
class Surroundings:
    """The world around the robots."""

    solids: tuple[Solid, ...]  # all that they can run into
    lidar_scene: RayScene  # all that their lidars see, at the height that both have in common
    sight_obstacles: SightObstacles  # all that can hide one robot from the other's camera

    def own_solids(self, other: Surroundings) -> tuple[Solid, ...]:
        """The solids that are not in the other ones."""
        if other is self:
            return ()
        shared = set(other.solids)
        return tuple(solid for solid in self.solids if solid not in shared)


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


def run_episode(
    surroundings: Surroundings | tuple[Surroundings, Surroundings],
    robots: tuple[RobotSpec, RobotSpec],
    starts: tuple[SE2, SE2],
    parameters: EpisodeParameters,
    *,
    rng: np.random.Generator,
) -> Episode:
    """Drive both robots until `max_events` rendezvous or `max_time_s`.

    `surroundings` may be of each robot its own: it runs into, scans and sees past what is in its own alone.
    `starts` are true poses in w; `rng` is split into one stream per source of randomness, so that none shifts
    another.
    """
    return _Exploration(surroundings, robots, starts, parameters, rng).finish()


class _Robot:
    """The simulated side of one robot: its noise, its true path, and the explorer that drives it."""

    def __init__(
        self, spec: RobotSpec, T_w_r: SE2, parameters: EpisodeParameters, rng: np.random.Generator
    ) -> None:
        encoder_rng, self._lidar_rng, explorer_rng = rng.spawn(3)
        self.spec = spec
        self.explorer = Explorer(spec, slam=parameters.slam, parameters=parameters.explorer, rng=explorer_rng)
        self._encoder = Encoder(parameters.odometry_noise, rng=encoder_rng)
        self._bearings_rad = beam_bearings(spec.lidar)
        self.knots_w = [T_w_r.as_array()]
        self.trajectory: list[Array] = []
        self.trajectory_w: list[Array] = []
        self.travelled_m = 0.0
        self.explorer.read_encoders(0.0, self._encoder.read((0.0, 0.0)))

    def tick(self, time_s: float, wheels_rad: tuple[float, float], pose_w: Array) -> None:
        """Pass the encoder readings on; keep the true pose for the lidar."""
        self.travelled_m += math.dist(pose_w[:2], self.knots_w[-1][:2])
        self.knots_w.append(pose_w)
        self.explorer.read_encoders(time_s, self._encoder.read(wheels_rad))

    def sweep(self, scene: RayScene, other: _Robot) -> None:
        """Shoot the sweep that ends now and hand it to the explorer."""
        lidar = self.spec.lidar
        ticks = lidar.sweep_s() / TICK_S
        T_w_l = _poses_along(last_part(np.array(self.knots_w), ticks), lidar.beams, lidar.x_m)
        circle = other.spec.circle_at(lidar.z_m)
        others_m = None
        apart_m = math.dist(self.knots_w[-1][:2], other.knots_w[-1][:2])
        if circle is not None and apart_m < lidar.range_max_m + 1.0:
            others_m = _poses_along(last_part(np.array(other.knots_w), ticks), lidar.beams, circle[0])
            others_m[:, 2] = circle[1]
        ranges_m = cast_rays(
            scene, T_w_l, self._bearings_rad, max_range_m=1.2 * lidar.range_max_m, others_m=others_m
        )
        noisy_m = noisy_ranges(ranges_m, lidar, rng=self._lidar_rng)
        self.explorer.read_lidar(noisy_m)

    def snapshot(self) -> Snapshot:
        """The robot as it is now."""
        return Snapshot(
            grid=self.explorer.slam.mapper.grid(),
            T_m_r=SE2.from_array(self.explorer.slam.pose()),
            T_m_r_odometry=SE2.from_array(self.explorer.odometry.pose()),
            T_w_r=SE2.from_array(self.knots_w[-1]),
            trajectory=np.array(self.trajectory),
            trajectory_w=np.array(self.trajectory_w),
        )


class _Exploration:
    """The loop of one episode."""

    def __init__(
        self,
        surroundings: Surroundings | tuple[Surroundings, Surroundings],
        robots: tuple[RobotSpec, RobotSpec],
        starts: tuple[SE2, SE2],
        parameters: EpisodeParameters,
        rng: np.random.Generator,
    ) -> None:
        physics_rng, rng_0, rng_1, schedule_rng = rng.spawn(4)
        self._p = parameters
        worlds = (surroundings, surroundings) if isinstance(surroundings, Surroundings) else surroundings
        self._worlds = worlds
        self._own_solids = (worlds[0].own_solids(worlds[1]), worlds[1].own_solids(worlds[0]))
        solids, only_for = _all_solids(worlds)
        self._physics = Physics(
            solids,
            robots,
            starts,
            drive=parameters.drive,
            planar_slip=parameters.odometry_noise.planar_slip,
            rng=physics_rng,
            only_for=only_for,
        )
        self._robots = (
            _Robot(robots[0], starts[0], parameters, rng_0),
            _Robot(robots[1], starts[1], parameters, rng_1),
        )
        # Log-uniform: overlap grows with the logarithm of time, roughly.
        low_s, high_s = parameters.first_event_s
        self._next_event_s = math.exp(schedule_rng.uniform(math.log(low_s), math.log(high_s)))
        self._next_event_m = [0.0, 0.0]
        self._events: list[Rendezvous] = []
        self._sweeps = 0
        # Both sweep at once, as often as the slower lidar.
        self._ticks_per_sweep = max(round(1.0 / (robot.lidar.rate_hz * TICK_S)) for robot in robots)
        self._sweeps_per_step = max(1, round(parameters.trajectory_step_s / (self._ticks_per_sweep * TICK_S)))

    def finish(self) -> Episode:
        """Run to the end."""
        twists = [(0.0, 0.0), (0.0, 0.0)]
        ticks = 0
        while self._physics.time_s < self._p.max_time_s and len(self._events) < self._p.max_events:
            self._physics.step(twists)
            ticks += 1
            poses_w = self._physics.poses_w()
            for i, robot in enumerate(self._robots):
                robot.tick(self._physics.time_s, self._physics.wheels_rad(i), poses_w[i])
            if ticks % self._ticks_per_sweep == 0:
                self._sweep()
            if self._sweeps:
                twists = [robot.explorer.twist() for robot in self._robots]
        first, second = self._robots
        return Episode(
            events=tuple(self._events),
            simulated_s=self._physics.time_s,
            last=(first.snapshot(), second.snapshot()),
        )

    def _sweep(self) -> None:
        """Finish a turn of both lidars, record the paths, and a rendezvous if there is one."""
        first, second = self._robots
        first.sweep(self._worlds[0].lidar_scene, second)
        second.sweep(self._worlds[1].lidar_scene, first)
        self._sweeps += 1
        sightings = self._sightings()
        for robot in self._robots:
            if sightings or (self._sweeps - 1) % self._sweeps_per_step == 0:
                robot.trajectory.append(np.array([self._physics.time_s, *robot.explorer.slam.pose()]))
                robot.trajectory_w.append(np.array([self._physics.time_s, *robot.knots_w[-1]]))
        if sightings:
            self._record(sightings)
        for robot in self._robots:
            robot.knots_w = robot.knots_w[-1:]

    def _sightings(self) -> tuple[Sighting | None, Sighting | None] | None:
        """What each robot sees of the other; None if there is no rendezvous to record."""
        if self._physics.time_s < self._next_event_s:
            return None
        if any(r.travelled_m < m for r, m in zip(self._robots, self._next_event_m, strict=True)):
            return None
        first, second = self._robots
        views = (self._sight(first, second), self._sight(second, first))
        if views == (None, None):
            return None
        least_m2 = self._p.least_explored_m2
        if any(robot.explorer.slam.mapper.known_area_m2() < least_m2 for robot in self._robots):
            return None
        return views

    def _sight(self, observer: _Robot, seen: _Robot) -> Sighting | None:
        p = self._p.sighting
        world = self._robots.index(observer)
        if _stands_in(seen, self._own_solids[world]):
            return None
        view = sight(
            observer.spec,
            seen.spec,
            SE2.from_array(observer.knots_w[-1]),
            SE2.from_array(seen.knots_w[-1]),
            self._worlds[world].sight_obstacles,
            min_range_m=p.min_range_m,
            max_range_m=p.max_range_m,
        )
        return view if view is not None and view.visible_fraction >= p.least_visible else None

    def _record(self, sightings: tuple[Sighting | None, Sighting | None]) -> None:
        first, second = self._robots
        self._events.append(
            Rendezvous(
                t_s=self._physics.time_s, sightings=sightings, snapshots=(first.snapshot(), second.snapshot())
            )
        )
        self._next_event_s = self._physics.time_s + self._p.event_gap_s
        self._next_event_m = [robot.travelled_m + self._p.event_gap_m for robot in self._robots]


def _all_solids(
    worlds: tuple[Surroundings, Surroundings],
) -> tuple[tuple[Solid, ...], tuple[int | None, ...]]:
    """The solids of both worlds, and the robot that alone runs into each; () if there is one world only."""
    first, second = worlds
    if second is first:
        return first.solids, ()
    own = set(first.own_solids(second))
    extra = second.own_solids(first)
    only_for = [0 if solid in own else None for solid in first.solids]
    return (*first.solids, *extra), (*only_for, *(1 for _ in extra))


def _stands_in(robot: _Robot, solids: Sequence[Solid]) -> bool:
    """Whether the robot stands where these solids, which it does not meet, are."""
    p_w = robot.knots_w[-1][:2]
    reach_m = robot.spec.radius_m
    return any(
        math.hypot(*np.maximum(np.abs(solid.T_w_s().inverse() @ p_w) - (solid.half_x_m, solid.half_y_m), 0.0))
        < reach_m
        for solid in solids
    )


@njit
def _poses_along(knots: Array, count: int, x_m: float) -> Array:
    """(count, 3): poses of a point at x on the robot's axis, evenly spaced in time over the knots (K, 3)."""
    poses = np.empty((count, 3))
    for i in range(count):
        at = i * (knots.shape[0] - 1) / count
        k = int(at)
        f = at - k
        yaw = knots[k, 2] + f * (knots[k + 1, 2] - knots[k, 2])
        poses[i, 0] = knots[k, 0] + f * (knots[k + 1, 0] - knots[k, 0]) + x_m * math.cos(yaw)
        poses[i, 1] = knots[k, 1] + f * (knots[k + 1, 1] - knots[k, 1]) + x_m * math.sin(yaw)
        poses[i, 2] = yaw
    return poses
