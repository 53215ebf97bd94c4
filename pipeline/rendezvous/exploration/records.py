"""How an episode is run, and what is recorded of it."""

from __future__ import annotations

from dataclasses import dataclass, field

from rendezvous.errors import ConfigError, require_within
from rendezvous.exploration.explorer import ExplorerParameters
from rendezvous.exploration.rendezvous import Sighting
from rendezvous.geometry.occupancy_grid import OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.simulation.drive import OdometryNoise
from rendezvous.simulation.world import Drive
from rendezvous.slam.slam import SlamParameters


@dataclass(frozen=True, slots=True, kw_only=True)
class SightingParameters:
    """What counts as a sighting.

    Attributes:
        min_range_m, max_range_m: distance from the camera to the centre of the other robot's cuboid.
        least_visible: least share of its cuboid's sample points in view.
    """

    min_range_m: float = 0.4
    max_range_m: float = 4.0
    least_visible: float = 0.5

    def __post_init__(self) -> None:
        require_within(
            self, min_range_m=(0, 100), max_range_m=(self.min_range_m, 100), least_visible=(0.01, 1)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeParameters:
    """How long an episode runs and which meetings are recorded.

    Attributes:
        drive: how the robots move.
        max_time_s: an episode ends then at the latest.
        first_event_s: bounds of the time before which no meeting is recorded, drawn log-uniformly for each
            episode: early meetings have little overlap, late ones much.
        least_explored_m2: area that each robot must know.
        max_events: meetings recorded per episode.
        event_gap_s, event_gap_m: time and travel of each robot between two of them.
        trajectory_step_s: spacing of the recorded paths.
    """

    drive: Drive
    max_time_s: float
    first_event_s: tuple[float, float]
    least_explored_m2: float = 4.0
    max_events: int
    event_gap_s: float = 10.0
    event_gap_m: float = 1.0
    trajectory_step_s: float = 1.0
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
    """One robot at a meeting.

    Attributes:
        grid: its map.
        T_m_r: its pose by SLAM.
        T_m_r_odometry: its pose by dead reckoning.
        T_w_r: its true pose.
        trajectory: (N, 4) t [s], x, y [m], yaw [rad] by SLAM in m.
        trajectory_w: (N, 4) the truth in w at the same times.
    """

    grid: OccupancyGrid
    T_m_r: SE2
    T_m_r_odometry: SE2
    T_w_r: SE2
    trajectory: Array
    trajectory_w: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """A meeting at `t_s`: who sees whom (`sightings[i]` is robot i's view, or None), and both robots."""

    t_s: float
    sightings: tuple[Sighting | None, Sighting | None]
    snapshots: tuple[Snapshot, Snapshot]


@dataclass(frozen=True, slots=True, kw_only=True)
class Episode:
    """What became of an episode: its meetings, how long it was, and both robots at its end."""

    events: tuple[Event, ...]
    simulated_s: float
    last: tuple[Snapshot, Snapshot]
