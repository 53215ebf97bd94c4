"""One exploring robot: measurements in, commands out.

It knows its encoders, its lidar and its own map, but neither the truth nor the other robot.
"""

from __future__ import annotations

import math

import numpy as np

from rendezvous.compiled import njit
from rendezvous.exploration.frontier import PlanningMap, Reach, frontiers, path_m, planning_map, reach
from rendezvous.exploration.records import ExplorerParameters
from rendezvous.geometry.se2 import Array
from rendezvous.simulation.drive import TICK_S
from rendezvous.simulation.robot import RobotSpec, beam_bearings
from rendezvous.slam.mapping import OccupancyMapper
from rendezvous.slam.slam import Slam, SlamParameters, Sweep, WheelOdometry, compose, last_part, relative

_SHUN_S = 30.0
_SHUN_MARGIN_M = 0.395  # a goal within the robot's radius and this of one given up is avoided as well


class Goals:
    """Chooses goals on the robot's own map, and remembers those to avoid for a while.

    Every margin of the parameters is added to the robot's radius.
    """

    def __init__(
        self, parameters: ExplorerParameters, *, robot_radius_m: float, rng: np.random.Generator
    ) -> None:
        self._p = parameters
        self._radius_m = robot_radius_m
        self._rng = rng
        # x, y [m], and the time [s] until which it counts.
        self._shunned: list[tuple[float, float, float]] = []
        self._bumps: list[tuple[float, float, float]] = []

    def shun(self, goal_m: Array, *, time_s: float) -> None:
        """Avoid goals near this one (x, y in the map) for a while."""
        self._shunned.append((float(goal_m[0]), float(goal_m[1]), time_s + _SHUN_S))

    def bump(self, place_m: Array, *, time_s: float) -> None:
        """Treat this place (x, y, ... in the map), where the robot met something unseen, as an obstacle."""
        self._bumps.append((float(place_m[0]), float(place_m[1]), time_s + _SHUN_S))

    def path_m(
        self, mapper: OccupancyMapper, pose: Array, last_m: Array, *, time_s: float, keep_patrol: bool
    ) -> Array:
        """(N, 2) [m] path to the frontier that costs least for its length; without frontiers, to anywhere.

        Empty if nothing can be reached. Without frontiers, `keep_patrol` goes on to where the last path
        leads.
        """
        self._shunned = [place for place in self._shunned if place[2] > time_s]
        self._bumps = [place for place in self._bumps if place[2] > time_s]
        p, mapping = self._p, mapper.parameters
        log_odds, T_m_g = mapper.window()
        plan = planning_map(
            log_odds, T_m_g, resolution_m=mapping.resolution_m, occupied=mapping.occupied, free=mapping.free
        ).with_obstacles([(x_m, y_m) for x_m, y_m, _ in self._bumps])
        ways = reach(
            plan,
            plan.cell_at(pose[0], pose[1]),
            hard_clearance_m=self._radius_m + p.hard_margin_m,
            soft_clearance_m=self._radius_m + p.soft_margin_m,
        )
        kept_m = last_m[-1] if keep_patrol and len(last_m) > 1 else None
        goal = self._frontier(plan, ways) or self._patrol(plan, ways, kept_m)
        return path_m(plan, ways, goal) if goal is not None else np.zeros((0, 2))

    def _frontier(self, plan: PlanningMap, ways: Reach) -> tuple[int, int] | None:
        cells, cost_m, length_m = frontiers(plan, ways, least_m=self._p.least_frontier_m)
        shun_m = self._radius_m + _SHUN_MARGIN_M
        best, best_score = None, math.inf
        for (row, col), cost, length in zip(cells.tolist(), cost_m, length_m, strict=True):
            x_m, y_m = plan.centre_m(row, col)
            if any(math.hypot(x_m - sx, y_m - sy) < shun_m for sx, sy, _ in self._shunned):
                continue
            score = cost - self._p.gain * length
            if cost >= self._p.lookahead_m and score < best_score:
                best, best_score = (row, col), score
        return best

    def _patrol(self, plan: PlanningMap, ways: Reach, kept_m: Array | None) -> tuple[int, int] | None:
        """The goal to keep if it can be reached, else uniform over the reachable cells with room to turn."""
        reachable = ways.reachable()
        if kept_m is not None and reachable[kept := plan.cell_at(*kept_m)]:
            return kept
        room_m = self._radius_m + self._p.soft_margin_m
        cells = np.argwhere(reachable & (plan.clearance_m > room_m))
        if len(cells) == 0:
            return None
        row, col = cells[self._rng.integers(len(cells))]
        return int(row), int(col)


_BACK_OFF_S = 1.2
_FORESIGHT_S = (0.2, 0.4, 0.6, 0.8)


@njit
def _pursued(path_m: Array, pose: Array, lookahead_m: float) -> tuple[int, int]:
    """Indices of the point of the path (N, 2) nearest to the robot, and of the one to steer for."""
    nearest, best2 = 0, np.inf
    for i in range(path_m.shape[0]):
        d2 = (path_m[i, 0] - pose[0]) ** 2 + (path_m[i, 1] - pose[1]) ** 2
        if d2 < best2:
            nearest, best2 = i, d2
    for i in range(nearest, path_m.shape[0]):
        d2 = (path_m[i, 0] - pose[0]) ** 2 + (path_m[i, 1] - pose[1]) ** 2
        if d2 > lookahead_m * lookahead_m:
            return nearest, i
    return nearest, path_m.shape[0] - 1


@njit
def _keeps_clear(points_m: Array, scan_r: Array, speed: float, turn: float, clear_m: float) -> bool:
    """Whether r, driving on with this twist, comes no nearer than `clear_m` to points it is approaching.

    Points (N, 2) are surfaces in the frame of the scan, whose pose in r is `scan_r`.
    """
    c, s = math.cos(scan_r[2]), math.sin(scan_r[2])
    farthest_m = clear_m + abs(speed) * _FORESIGHT_S[-1]
    for i in range(points_m.shape[0]):
        x = scan_r[0] + c * points_m[i, 0] - s * points_m[i, 1]
        y = scan_r[1] + s * points_m[i, 0] + c * points_m[i, 1]
        now2 = x * x + y * y
        if now2 > farthest_m * farthest_m:
            continue
        for ahead_s in _FORESIGHT_S:
            half_turn, ahead_m = 0.5 * turn * ahead_s, speed * ahead_s
            near2 = (x - ahead_m * math.cos(half_turn)) ** 2 + (y - ahead_m * math.sin(half_turn)) ** 2
            if near2 < clear_m * clear_m and near2 < now2:
                return False
    return True


class Explorer:
    """Odometry, SLAM, frontier planning and path following of one robot."""

    def __init__(
        self,
        spec: RobotSpec,
        *,
        slam: SlamParameters,
        parameters: ExplorerParameters,
        rng: np.random.Generator,
    ) -> None:
        self._spec = spec
        self._p = parameters
        self._rng = rng
        self._goals = Goals(parameters, robot_radius_m=spec.radius_m, rng=rng)
        lidar = spec.lidar
        self.slam = Slam(
            bearings_rad=beam_bearings(lidar),
            lidar_x_m=lidar.x_m,
            lidar_sigma=(lidar.noise.sigma_m, lidar.noise.sigma_ratio),
            no_echo_m=lidar.clears_m(),
            parameters=slam.with_normals(lidar.step_rad(), to_m=lidar.normals_to_m),
        )
        self.odometry = WheelOdometry(wheel_radius_m=spec.wheels.radius_m, track_m=spec.wheels.track_m)
        self._knots: list[Array] = []
        self._time_s = 0.0
        self._path_m = np.zeros((0, 2))
        self._plan_until_s = 0.0
        self._progress = np.zeros(3)
        self._progress_s = 0.0
        self._back_off_until_s = 0.0
        self._back_off_turn = 0.0
        self._back_off_speed = 0.0
        self._slipping = 0
        self._twist = (0.0, 0.0)

    def read_encoders(self, time_s: float, wheels_rad: tuple[float, float]) -> None:
        """Take a reading of the left and right wheel angle [rad]."""
        self._time_s = time_s
        self.odometry.update(wheels_rad)
        self._knots.append(self.odometry.pose())

    def read_lidar(self, ranges_m: Array) -> None:
        """Take the sweep that ended with the last encoder reading: (B,) [m]."""
        before = self.slam.pose() if self.slam.has_started() else None
        self.slam.update(Sweep(ranges_m=ranges_m, odometry=self._swept()))
        if before is not None:
            self._feel(relative(self._knots[0], self._knots[-1]), relative(before, self.slam.pose()))
        self._knots = self._knots[-1:]

    def _swept(self) -> Array:
        """(K, 3) odometry during the sweep that ended now."""
        return last_part(np.array(self._knots), self._spec.lidar.sweep_s() / TICK_S)

    def _feel(self, rolled: Array, moved: Array) -> None:
        """Notice wheels that turn without moving the robot."""
        slip = rolled - moved
        is_slip = math.hypot(slip[0], slip[1]) > self._p.slip_m or abs(slip[2]) > self._p.slip_rad
        self._slipping = self._slipping + 1 if is_slip else 0

    def pose(self) -> Array:
        """(3,) pose in the map: SLAM's last one carried on by odometry."""
        return compose(self.slam.pose(), relative(self._knots[0], self._knots[-1]))

    def twist(self) -> tuple[float, float]:
        """Speed [m/s] and turn rate [rad/s] to drive with until the next reading."""
        p = self._p
        speed, turn = self._wanted_twist(self.pose())
        last_speed, last_turn = self._twist
        step, turn_step = p.accel_mps2 * TICK_S, p.turn_accel_radps2 * TICK_S
        self._twist = (
            max(last_speed - step, min(last_speed + step, speed)),
            max(last_turn - turn_step, min(last_turn + turn_step, turn)),
        )
        return self._twist

    def _wanted_twist(self, pose: Array) -> tuple[float, float]:
        if self._time_s < self._back_off_until_s:
            return self._reverse(pose)
        if self._slipping >= 2:
            ahead_m = math.copysign(1.5 * self._spec.radius_m, self._twist[0])
            self._goals.bump(compose(pose, np.array([ahead_m, 0.0, 0.0])), time_s=self._time_s)
            return self._back_off(pose)
        if self._is_stuck(pose):
            return self._back_off(pose)
        if self._wants_plan(pose):
            past_due = self._time_s >= self._plan_until_s
            self._path_m = self._goals.path_m(
                self.slam.mapper, pose, self._path_m, time_s=self._time_s, keep_patrol=past_due
            )
            self._plan_until_s = self._time_s + self._p.replan_s
        if len(self._path_m) == 0:
            return 0.0, 0.5 * self._p.turn_limit_radps
        return self._follow(pose)

    def _follow(self, pose: Array) -> tuple[float, float]:
        """Pure pursuit of the path, turning on the spot for large errors."""
        p = self._p
        nearest, target = _pursued(self._path_m, pose, p.lookahead_m)
        to_x, to_y = self._path_m[target] - pose[:2]
        self._path_m = self._path_m[nearest:]
        error = math.remainder(math.atan2(to_y, to_x) - pose[2], 2.0 * math.pi)
        turn = max(-p.turn_limit_radps, min(p.turn_limit_radps, p.turn_gain * error))
        if abs(error) > p.turn_first_rad:
            return 0.0, turn
        speed = self._spec.max_speed_mps * (1.0 - 0.6 * abs(error) / p.turn_first_rad)
        if self._is_clear(pose, speed, turn):
            return speed, turn
        # Too close to something: look again soon, turning towards the path meanwhile.
        self._plan_until_s = min(self._plan_until_s, self._time_s + 0.5)
        if self._is_clear(pose, 0.4 * speed, turn):
            return 0.4 * speed, turn
        return 0.0, math.copysign(max(abs(turn), 0.3), error)

    def _is_clear(self, pose: Array, speed: float, turn: float) -> bool:
        """Whether the robot, driving so, stays clear of the last sweep's surfaces or moves away from them."""
        scan_r = relative(pose, self.slam.pose())
        clear_m = self._spec.radius_m + self._p.clear_margin_m
        return _keeps_clear(self.slam.points_m, scan_r, speed, turn, clear_m)

    def _wants_plan(self, pose: Array) -> bool:
        if len(self._path_m) == 0 or self._time_s >= self._plan_until_s:
            return True
        goal = self._path_m[-1]
        return math.hypot(goal[0] - pose[0], goal[1] - pose[1]) < self._p.lookahead_m

    def _is_stuck(self, pose: Array) -> bool:
        moved = relative(self._progress, pose)
        if math.hypot(moved[0], moved[1]) > 0.10 or abs(moved[2]) > 0.6:
            self._progress, self._progress_s = pose, self._time_s
        return self._time_s - self._progress_s > self._p.stuck_s

    def _back_off(self, pose: Array) -> tuple[float, float]:
        """Give up the goal for a while, and reverse along a random arc."""
        if len(self._path_m):
            self._goals.shun(self._path_m[-1], time_s=self._time_s)
        self._path_m = np.zeros((0, 2))
        self._slipping = 0
        self._progress_s = self._time_s
        self._back_off_until_s = self._time_s + _BACK_OFF_S
        # Uniform turn rate: two robots that block each other part ways.
        self._back_off_turn = float(self._rng.uniform(-1.0, 1.0))
        self._back_off_speed = -math.copysign(0.5 * self._spec.max_speed_mps, self._twist[0])
        return self._reverse(pose)

    def _reverse(self, pose: Array) -> tuple[float, float]:
        """Drive backwards, unless something is behind."""
        if self._is_clear(pose, self._back_off_speed, self._back_off_turn):
            return self._back_off_speed, self._back_off_turn
        return 0.0, self._back_off_turn
