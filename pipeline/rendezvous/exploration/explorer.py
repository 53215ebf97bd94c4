"""One exploring robot: what it measures goes in, what it commands comes out.

It knows its encoders, its lidar and its own map; nothing of the truth, nothing of the other robot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rendezvous.compiled import njit
from rendezvous.errors import require_within
from rendezvous.exploration.frontier import PlanningMap, Reach, frontiers, path_m, planning_map, reach
from rendezvous.geometry.se2 import Array
from rendezvous.simulation.drive import TICK_S
from rendezvous.simulation.lidar import beam_bearings
from rendezvous.simulation.robot import RobotSpec
from rendezvous.slam.odometry import WheelOdometry
from rendezvous.slam.slam import Slam, SlamParameters, Sweep, compose, relative


@dataclass(frozen=True, slots=True, kw_only=True)
class ExplorerParameters:
    """How a robot explores.

    Attributes:
        hard_margin_m, soft_margin_m: what `frontier.reach`'s clearances add to the robot's radius.
        least_frontier_m: shorter frontiers are not worth a visit.
        gain: metres of travel that a metre of frontier is worth.
        replan_s: how long a plan is followed at most before the map is looked at again.
        lookahead_m: distance to the point of the path that is steered for.
        turn_gain: turn rate per heading error [1/s].
        turn_limit_radps: largest turn rate; a lidar sweep skews with it.
        turn_first_rad: with a larger heading error the robot turns on the spot.
        accel_mps2, turn_accel_radps2: limits on changes of the command.
        clear_margin_m: distance, beyond the robot's radius, that r keeps from every surface in sight.
        slip_m, slip_rad: encoders and SLAM disagreeing by more over one sweep means that something unseen
            holds the robot; it backs off.
        stuck_s: without progress for so long, it backs off and looks for another goal.
    """

    hard_margin_m: float = 0.045
    soft_margin_m: float = 0.195
    least_frontier_m: float = 0.4
    gain: float = 0.6
    replan_s: float = 4.0
    lookahead_m: float = 0.30
    turn_gain: float = 2.5
    turn_limit_radps: float = 1.5
    turn_first_rad: float = 0.8
    accel_mps2: float = 1.0
    turn_accel_radps2: float = 6.0
    clear_margin_m: float = 0.02
    slip_m: float = 0.012
    slip_rad: float = 0.06
    stuck_s: float = 5.0

    def __post_init__(self) -> None:
        require_within(
            self, hard_margin_m=(0, 2), soft_margin_m=(self.hard_margin_m, 5),
            least_frontier_m=(0.05, 10), gain=(0, 100), replan_s=(0.1, 600), lookahead_m=(0.05, 5),
            turn_gain=(0.1, 20), turn_limit_radps=(0.05, 10), turn_first_rad=(0.05, 3.2),
            accel_mps2=(0.05, 50), turn_accel_radps2=(0.1, 100), clear_margin_m=(0, 2), slip_m=(1e-3, 1),
            slip_rad=(1e-3, 7), stuck_s=(0.5, 600),
        )  # fmt: skip


_BACK_OFF_S = 1.2
_SHUN_S = 30.0
_SHUN_MARGIN_M = 0.395  # a goal this near to one given up, beyond the robot's radius, is given up as well
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

    Args:
        points_m: (N, 2) surfaces in the frame of the scan.
        scan_r: (3,) pose of that frame in r.
        speed, turn: the twist.
        clear_m: distance to keep.
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
    """Odometry, SLAM, frontier planning and path following of one robot.

    Args:
        spec: the robot.
        slam: settings.
        parameters: settings.
        rng: draws where to go once everything is explored, and how to back off.
    """

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
        lidar = spec.lidar
        self.slam = Slam(
            bearings_rad=beam_bearings(lidar),
            lidar_x_m=lidar.x_m,
            lidar_sigma=(lidar.noise.sigma_m, lidar.noise.sigma_ratio),
            no_echo_m=lidar.clears_m(),
            parameters=slam,
        )
        self._odometry = WheelOdometry(wheel_radius_m=spec.wheels.radius_m, track_m=spec.wheels.track_m)
        self._knots: list[Array] = []
        self._time_s = 0.0
        self._path_m = np.zeros((0, 2))
        self._plan_until_s = 0.0
        self._shunned: list[tuple[float, float, float]] = []
        self._progress = np.zeros(3)
        self._progress_s = 0.0
        self._back_off_until_s = 0.0
        self._back_off_turn = 0.0
        self._back_off_speed = 0.0
        self._bumps: list[tuple[float, float, float]] = []
        self._slipping = 0
        self._twist = (0.0, 0.0)

    def read_encoders(self, time_s: float, wheels_rad: tuple[float, float]) -> None:
        """Take a reading of the wheel angles (left, right)."""
        self._time_s = time_s
        self._odometry.update(wheels_rad)
        self._knots.append(self._odometry.pose())

    def read_lidar(self, ranges_m: Array) -> None:
        """Take the sweep that ended with the last encoder reading: (B,) [m]."""
        before = self.slam.pose() if self.slam.has_started() else None
        self.slam.update(Sweep(ranges_m=ranges_m, odometry=np.array(self._knots)))
        if before is not None:
            self._feel(relative(self._knots[0], self._knots[-1]), relative(before, self.slam.pose()))
        self._knots = self._knots[-1:]

    def _feel(self, rolled: Array, moved: Array) -> None:
        """Notice that the wheels turn without the robot following."""
        slip = rolled - moved
        is_slip = math.hypot(slip[0], slip[1]) > self._p.slip_m or abs(slip[2]) > self._p.slip_rad
        self._slipping = self._slipping + 1 if is_slip else 0

    def odometry_pose(self) -> Array:
        """(3,) dead-reckoned pose, its origin at the start."""
        return self._odometry.pose()

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
            x_m, y_m, _ = compose(pose, np.array([ahead_m, 0.0, 0.0]))
            self._bumps.append((float(x_m), float(y_m), self._time_s + _SHUN_S))
            return self._back_off(pose)
        if self._is_stuck(pose):
            return self._back_off(pose)
        if self._wants_plan(pose):
            self._make_plan(pose)
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
        """Whether this twist keeps its distance from all surfaces of the last sweep, or leaves them."""
        scan_r = relative(pose, self.slam.pose())
        clear_m = self._spec.radius_m + self._p.clear_margin_m
        return _keeps_clear(self.slam.points_m, scan_r, speed, turn, clear_m)

    def _wants_plan(self, pose: Array) -> bool:
        if len(self._path_m) == 0 or self._time_s >= self._plan_until_s:
            return True
        goal = self._path_m[-1]
        return math.hypot(goal[0] - pose[0], goal[1] - pose[1]) < self._p.lookahead_m

    def _make_plan(self, pose: Array) -> None:
        """Head for the frontier that costs least for its length; with none left, for anywhere."""
        p = self._p
        mapping = self.slam.parameters.mapping
        log_odds, T_m_g = self.slam.mapper.window()
        plan = planning_map(
            log_odds, T_m_g, resolution_m=mapping.resolution_m, occupied=mapping.occupied, free=mapping.free
        )
        self._bumps = [bump for bump in self._bumps if bump[2] > self._time_s]
        plan = plan.with_obstacles([(x_m, y_m) for x_m, y_m, _ in self._bumps])
        ways = reach(
            plan,
            plan.cell_at(pose[0], pose[1]),
            hard_clearance_m=self._spec.radius_m + p.hard_margin_m,
            soft_clearance_m=self._spec.radius_m + p.soft_margin_m,
        )
        goal = self._frontier_goal(plan, ways, pose) or self._patrol_goal(plan, ways)
        self._path_m = path_m(plan, ways, goal) if goal is not None else np.zeros((0, 2))
        self._plan_until_s = self._time_s + p.replan_s

    def _frontier_goal(self, plan: PlanningMap, ways: Reach, pose: Array) -> tuple[int, int] | None:
        cells, cost_m, length_m = frontiers(plan, ways, least_m=self._p.least_frontier_m)
        self._shunned = [s for s in self._shunned if s[2] > self._time_s]
        shun_m = self._spec.radius_m + _SHUN_MARGIN_M
        best, best_score = None, math.inf
        for (row, col), cost, length in zip(cells.tolist(), cost_m, length_m, strict=True):
            x_m, y_m = plan.centre_m(row, col)
            if any(math.hypot(x_m - sx, y_m - sy) < shun_m for sx, sy, _ in self._shunned):
                continue
            if cost < self._p.lookahead_m:
                continue
            score = cost - self._p.gain * length
            if score < best_score:
                best, best_score = (row, col), score
        return best

    def _patrol_goal(self, plan: PlanningMap, ways: Reach) -> tuple[int, int] | None:
        """Uniform over the reachable cells with room to turn."""
        if len(self._path_m) > 1 and self._time_s >= self._plan_until_s:
            row, col = plan.cell_at(*self._path_m[-1])
            if ways.reachable()[row, col]:
                return row, col
        cells = np.argwhere(
            ways.reachable() & (plan.clearance_m > self._spec.radius_m + self._p.soft_margin_m)
        )
        if len(cells) == 0:
            return None
        row, col = cells[self._rng.integers(len(cells))]
        return int(row), int(col)

    def _is_stuck(self, pose: Array) -> bool:
        moved = relative(self._progress, pose)
        if math.hypot(moved[0], moved[1]) > 0.10 or abs(moved[2]) > 0.6:
            self._progress, self._progress_s = pose, self._time_s
        return self._time_s - self._progress_s > self._p.stuck_s

    def _back_off(self, pose: Array) -> tuple[float, float]:
        """Leave this goal alone for a while, and reverse along a random arc."""
        if len(self._path_m):
            goal = self._path_m[-1]
            self._shunned.append((float(goal[0]), float(goal[1]), self._time_s + _SHUN_S))
        self._path_m = np.zeros((0, 2))
        self._slipping = 0
        self._progress_s = self._time_s
        self._back_off_until_s = self._time_s + _BACK_OFF_S
        # Uniform turn rate: two robots that block each other part ways.
        self._back_off_turn = float(self._rng.uniform(-1.0, 1.0))
        self._back_off_speed = -math.copysign(0.5 * self._spec.max_speed_mps, self._twist[0])
        return self._reverse(pose)

    def _reverse(self, pose: Array) -> tuple[float, float]:
        """Go back, unless there is something behind."""
        if self._is_clear(pose, self._back_off_speed, self._back_off_turn):
            return self._back_off_speed, self._back_off_turn
        return 0.0, self._back_off_turn
