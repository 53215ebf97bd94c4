from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from rendezvous.exploration import explorer as explorer_module
from rendezvous.exploration.explorer import Explorer
from rendezvous.exploration.frontier import reach
from rendezvous.exploration.records import ExplorerParameters
from rendezvous.simulation.rays import cast_rays, ray_scene
from rendezvous.simulation.robot import RobotSpec, beam_bearings
from rendezvous.slam.slam import SlamParameters
from tests.simulation.scenes import burger, room_segments


def started(robot: RobotSpec) -> Explorer:
    """An explorer after its first sweep, in the middle of a room of 4 m x 3 m."""
    explorer = Explorer(
        robot, slam=SlamParameters(), parameters=ExplorerParameters(), rng=np.random.default_rng(0)
    )
    for tick in range(5):
        explorer.read_encoders(0.05 * tick, (0.0, 0.0))
    scene = ray_scene(room_segments(4.0, 3.0), np.zeros((0, 3)))
    pose = np.tile([2.0, 1.5, 0.0], (robot.lidar.beams, 1))
    explorer.read_lidar(cast_rays(scene, pose, beam_bearings(robot.lidar), max_range_m=3.5))
    return explorer


@pytest.mark.parametrize("radius_m", [0.105, 0.2])
def test_paths_keep_the_robots_own_radius_and_a_margin(
    monkeypatch: pytest.MonkeyPatch, radius_m: float
) -> None:
    clearances_m = []

    def recorded(*args: object, hard_clearance_m: float, soft_clearance_m: float) -> object:
        clearances_m.append((hard_clearance_m, soft_clearance_m))
        return reach(*args, hard_clearance_m=hard_clearance_m, soft_clearance_m=soft_clearance_m)  # type: ignore[arg-type]

    monkeypatch.setattr(explorer_module, "reach", recorded)
    started(replace(burger(), radius_m=radius_m)).twist()
    assert clearances_m == [approx((radius_m + 0.045, radius_m + 0.195))]
