"""The pairs of one recorded log."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rendezvous.config.sections import RecordedLog, ReplaySection
from rendezvous.errors import LogError
from rendezvous.interop.carmen_log import PosesOf
from rendezvous.interop.laser_logs import log_name, read_laser_log
from rendezvous.interop.trajectory_files import read_relations
from rendezvous.recorded.error import related_scans
from rendezvous.recorded.laser_log import LaserLog
from rendezvous.recorded.meetings import Meeting, draw_meeting, driven_parts
from rendezvous.recorded.replayed import facing_camera, replayed
from rendezvous.schema import PAIRS
from rendezvous.seeds import stream
from rendezvous.simulation.robot import RobotSpec
from rendezvous.stages.dataset.sightings import pair_columns, seen_columns
from rendezvous.store.records import Quarantined, Shard


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownLog:
    """A log with the digests of its files: the log itself, then those that say where the robot was."""

    given: RecordedLog
    digests: Mapping[str, str]  # by file name

    @property
    def name(self) -> str:
        return log_name(Path(self.given.path))

    @property
    def sha256(self) -> str:
        """SHA-256 of the log's file."""
        return next(iter(self.digests.values()))

    @property
    def building(self) -> str:
        return self.given.building or self.name

    @property
    def building_digest(self) -> str:
        """SHA-256 of the building's name, by which it is split."""
        return hashlib.sha256(f"building {self.building}".encode()).hexdigest()

    def parameters(self) -> dict[str, Any]:
        """What of the log its pairs depend on, besides the files."""
        given = self.given.model_dump(mode="json", include={"poses", "range_max_m", "topic", "lidar_pose"})
        return {f"replay.log.{key}": value for key, value in given.items()} | {
            "replay.log.building": self.building
        }


def pairs_of_log(log: KnownLog, section: ReplaySection, robot: RobotSpec, seed: int) -> Shard:
    """The pairs of a log; one that cannot be used has none, and is quarantined."""
    counts: Counter[str] = Counter(logs=0, pairs=0, drawn=0, no_meeting=0, overlap_beyond_bounds=0)
    counts["little_explored"] = 0
    try:
        rows = _rows(log, section, robot, seed, counts)
        if not rows:
            raise LogError(
                f"{log.given.path}: no pair in {counts['drawn']} draws ({counts['no_meeting']} had no one in "
                f"sight or too short a way, {counts['little_explored']} too small a map, "
                f"{counts['overlap_beyond_bounds']} an overlap beyond replay.overlap)"
            )
    except LogError as error:
        fault = Quarantined(item_id=log.name, reason=str(error), where=log.given.path)
        return Shard(table=PAIRS.table([]), counts=counts, quarantined=(fault,))
    counts["logs"], counts["pairs"] = 1, len(rows)
    return Shard(table=PAIRS.table(rows), counts=counts)


def _rows(
    known: KnownLog, section: ReplaySection, robot: RobotSpec, seed: int, counts: Counter[str]
) -> list[dict[str, Any]]:
    given = known.given
    log = read_laser_log(
        Path(given.path),
        poses=PosesOf(given.poses),
        range_max_m=given.range_max_m,
        reference=None if given.reference is None else Path(given.reference),
        topic=given.topic,
        lidar_pose=given.lidar_pose,
    )
    if log.reference is None:
        raise LogError(
            f"{given.path}: no reference poses, so nothing says where two stretches meet; give the true path "
            "with `reference`, or `poses: reference` if those in the log were corrected"
        )
    relations = None
    if given.relations is not None:
        relations = related_scans(log.t_s, read_relations(Path(given.relations)))
    parts = driven_parts(log)
    rows: list[dict[str, Any]] = []
    while (
        len(rows) < section.pairs_per_log and counts["drawn"] < section.draws_per_pair * section.pairs_per_log
    ):
        # Of the number of the draw, not of the row: what is left out moves no other.
        rng = stream(seed, "replay", known.sha256, counts["drawn"])
        counts["drawn"] += 1
        meeting = draw_meeting(log, parts, section.stretches, relations=relations, rng=rng)
        if meeting is None:
            counts["no_meeting"] += 1
            continue
        columns = _columns(log, meeting, section, robot, rng, counts)
        if columns is not None:
            rows.append({**_identity(known, meeting, len(rows), seed), **columns})
    return rows


def _columns(
    log: LaserLog,
    meeting: Meeting,
    section: ReplaySection,
    robot: RobotSpec,
    rng: np.random.Generator,
    counts: Counter[str],
) -> dict[str, Any] | None:
    """What two robots know when they meet; None if a map is too small or the overlap beyond bounds."""
    event, starts = replayed(
        log, meeting, robot, lidar=section.lidar, slam=section.slam, noise=section.odometry, rng=rng
    )
    for snapshot in event.snapshots:
        grid = snapshot.grid
        if grid.known().sum() * grid.resolution_m**2 < section.least_explored_m2:
            counts["little_explored"] += 1
            return None
    columns = pair_columns(starts, event, 0, (0, 0))
    if not section.overlap[0] <= columns["overlap"] <= section.overlap[1]:
        counts["overlap_beyond_bounds"] += 1
        return None
    sighting = event.sightings[0]
    assert sighting is not None, "robot 0 sees robot 1"
    seen = seen_columns(sighting, robot, facing_camera(robot, meeting.T_r0_r1))
    return {"t_s": event.t_s, **seen, **columns}


def _identity(known: KnownLog, meeting: Meeting, number: int, seed: int) -> dict[str, Any]:
    event_id = f"{known.name}-{number:04d}"
    ways = (f"{scans[0]}-{scans[-1]}" for scans in (meeting.scans_0, meeting.scans_1))
    return {
        "pair_id": f"{event_id}-0",
        "event_id": event_id,
        "episode_id": f"{Path(known.given.path).name} {known.sha256[:12]} {' '.join(ways)}",
        "observer": 0,
        "plan_id": known.building,
        "plan_digest": known.building_digest,
        "seed": seed,
        "drive": "recorded",
    }
