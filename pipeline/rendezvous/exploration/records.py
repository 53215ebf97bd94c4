"""The parameters of an episode, and its record."""

from __future__ import annotations

from dataclasses import dataclass, field

from rendezvous.errors import ConfigError, require_within
from rendezvous.exploration.rendezvous import Sighting
from rendezvous.geometry.occupancy_grid import OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.simulation.drive import OdometryNoise
from rendezvous.simulation.world import Drive
from rendezvous.slam.slam import SlamParameters


@dataclass(frozen=True, slots=True, kw_only=True)
class SightingParameters:
    """When a robot in view counts as a sighting."""

    # min_range_m, max_range_m: distance from the camera to the centre of the other robot's cuboid.
    min_range_m: float = 0.4
    max_range_m: float = 4.0
    least_visible: float = 0.5  # smallest share of its cuboid's sample points in view

    def __post_init__(self) -> None:
        require_within(
            self, min_range_m=(0, 100), max_range_m=(self.min_range_m, 100), least_visible=(0.01, 1)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ExplorerParameters:
    """How a robot explores. Margins are distances beyond the robot's radius."""

    hard_margin_m: float = 0.045  # paths never come closer to an obstacle
    soft_margin_m: float = 0.195  # paths come closer only if the way round is much longer
    least_frontier_m: float = 0.4  # shorter frontiers are ignored
    gain: float = 0.6  # metres of travel that a metre of frontier is worth
    replan_s: float = 4.0  # longest time that a plan is followed before the next one is made
    lookahead_m: float = 0.30  # distance to the point of the path that the robot steers for
    turn_gain: float = 2.5  # turn rate per heading error [1/s]
    turn_limit_radps: float = 1.5  # largest turn rate; a lidar sweep skews with it
    turn_first_rad: float = 0.8  # heading error above which the robot turns on the spot
    # accel_mps2, turn_accel_radps2: limits on changes of the command.
    accel_mps2: float = 1.0
    turn_accel_radps2: float = 6.0
    clear_margin_m: float = 0.02  # while driving, the robot keeps this distance from every surface in sight
    # slip_m, slip_rad: if encoders and SLAM disagree by more over one sweep, something unseen holds the
    # robot, and it backs off.
    slip_m: float = 0.012
    slip_rad: float = 0.06
    stuck_s: float = 5.0  # after this long without progress the robot backs off and looks for another goal

    def __post_init__(self) -> None:
        require_within(
            self, hard_margin_m=(0, 2), soft_margin_m=(self.hard_margin_m, 5),
            least_frontier_m=(0.05, 10), gain=(0, 100), replan_s=(0.1, 600), lookahead_m=(0.05, 5),
            turn_gain=(0.1, 20), turn_limit_radps=(0.05, 10), turn_first_rad=(0.05, 3.2),
            accel_mps2=(0.05, 50), turn_accel_radps2=(0.1, 100), clear_margin_m=(0, 2), slip_m=(1e-3, 1),
            slip_rad=(1e-3, 7), stuck_s=(0.5, 600),
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeParameters:
    """How long an episode runs and which rendezvous are recorded."""

    drive: Drive  # how the robots move
    max_time_s: float  # longest episode
    # Bounds of the time of the first rendezvous, drawn log-uniformly for each episode: in early ones the maps
    # overlap little, in late ones much.
    first_event_s: tuple[float, float]
    least_explored_m2: float = 4.0  # area that each robot must know at a rendezvous
    max_events: int  # most rendezvous recorded per episode
    # event_gap_s, event_gap_m: least time, and travel of each robot, from one rendezvous to the next.
    event_gap_s: float = 10.0
    event_gap_m: float = 1.0
    trajectory_step_s: float = 1.0  # spacing of the recorded paths
    sighting: SightingParameters = field(default_factory=SightingParameters)
    odometry_noise: OdometryNoise = field(default_factory=OdometryNoise)
    explorer: ExplorerParameters = field(default_factory=ExplorerParameters)
    slam: SlamParameters = field(default_factory=SlamParameters)

    def __post_init__(self) -> None:
        require_within(
            self, max_time_s=(1, 36_000), least_explored_m2=(0, 1e6), max_events=(1, 1000),
            event_gap_s=(0, 36_000), event_gap_m=(0, 1e6), trajectory_step_s=(0.01, 600),
        )  # fmt: skip
        low_s, high_s = self.first_event_s
        if not 0.0 < low_s <= high_s:
            raise ConfigError(
                f"EpisodeParameters: first_event_s is [{low_s}, {high_s}]; must be two rising times above 0"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """One robot at a rendezvous."""

    grid: OccupancyGrid  # its map
    T_m_r: SE2  # its pose by SLAM
    T_m_r_odometry: SE2  # its pose by dead reckoning
    T_w_r: SE2  # its true pose
    trajectory: Array  # (N, 4) t [s], x, y [m], yaw [rad] by SLAM in m
    trajectory_w: Array  # (N, 4) the truth in w at the same times


@dataclass(frozen=True, slots=True, kw_only=True)
class Rendezvous:
    """Two robots near each other at `t_s`; `sightings[i]` is what robot i sees of the other, or None."""

    t_s: float
    sightings: tuple[Sighting | None, Sighting | None]
    snapshots: tuple[Snapshot, Snapshot]


@dataclass(frozen=True, slots=True, kw_only=True)
class Episode:
    """The rendezvous of an episode, its length, and both robots at its end."""

    events: tuple[Rendezvous, ...]
    simulated_s: float
    last: tuple[Snapshot, Snapshot]
