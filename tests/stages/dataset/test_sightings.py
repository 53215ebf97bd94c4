"""Rows from an event made by hand, in which every number is another one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rendezvous.exploration.records import Episode, Rendezvous, Snapshot
from rendezvous.exploration.rendezvous import Sighting
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, OccupancyGrid
from rendezvous.geometry.se2 import SE2
from rendezvous.plan_schema import solid_rows
from rendezvous.robot_file import load_robot
from rendezvous.schema import EXPLORE
from rendezvous.stages.dataset.sightings import EpisodeScene, sighting_rows
from tests.floorplan.plans import TWO_ROOMS, plan_of
from tests.simulation.scenes import pole

STARTS = (SE2(1.0, 1.0, 0.5), SE2(4.0, 3.0, -1.0))
TRUE = (SE2(2.0, 1.5, 0.3), SE2(3.0, 2.5, 2.8))
SLAM_OFF = (SE2(0.03, 0.04, 0.01), SE2(0.06, 0.08, 0.02))
ODOMETRY_OFF = (SE2(0.3, 0.4, 0.1), SE2(0.6, 0.8, 0.2))
SIGHTINGS = (
    Sighting(range_m=1.0, bearing_rad=0.1, visible_fraction=0.6),
    Sighting(range_m=2.0, bearing_rad=0.2, visible_fraction=0.7),
)


def _snapshot(i: int, ghosts_w_m: list[tuple[float, float]]) -> Snapshot:
    """Robot i's: a free map of 10 m by 10 m but for the cells at these places; a path along x."""
    T_m_r = STARTS[i].inverse() @ TRUE[i] @ SLAM_OFF[i]
    T_m_g = SE2(-5.0, -5.0, 0.0)
    cells = np.full((200, 200), FREE, np.uint8)
    for place_w in ghosts_w_m:
        p_m = T_m_r @ TRUE[i].inverse() @ np.array(place_w)
        col, row = np.floor((T_m_g.inverse() @ p_m) / 0.05).astype(int)
        cells[row, col] = OCCUPIED
    t_s = np.arange(3.0)
    path_w = np.stack([t_s, TRUE[i].x_m + 0.1 * t_s, np.full(3, TRUE[i].y_m), np.full(3, 0.2)], axis=1)
    return Snapshot(
        grid=OccupancyGrid(cells=cells, resolution_m=0.05, T_m_g=T_m_g),
        T_m_r=T_m_r,
        T_m_r_odometry=STARTS[i].inverse() @ TRUE[i] @ ODOMETRY_OFF[i],
        T_w_r=TRUE[i],
        trajectory=path_w + i + 1.0,
        trajectory_w=path_w,
    )


def _rows(sightings: tuple[Sighting | None, Sighting | None], **of_scene: Any) -> list[dict[str, Any]]:
    """One ghost in robot 0's map, on robot 1's path; none in robot 1's, which has a cell on its own path."""
    snapshots = (_snapshot(0, [(3.1, 2.5)]), _snapshot(1, [(3.1, 2.5)]))
    event = Rendezvous(t_s=7.0, sightings=sightings, snapshots=snapshots)
    outline_m = np.array([[0.0, 0.0, 5.0, 0.0]])
    scene = EpisodeScene(
        plan=plan_of(TWO_ROOMS),
        density=1.0,
        starts=STARTS,
        robot=load_robot("burger"),
        drive="wheels",
        **({"furniture": ([], []), "lidar_segments_m": (outline_m, outline_m)} | of_scene),
    )
    episode = Episode(events=(event,), simulated_s=9.0, last=snapshots)
    return list(sighting_rows(scene, episode, episode_id="plan-e003", seed=5))


def test_an_event_in_which_both_see_each_other_is_two_rows_that_the_schema_takes():
    rows = _rows(SIGHTINGS)
    assert [row["pair_id"] for row in rows] == ["plan-e003-m0-0", "plan-e003-m0-1"]
    assert {row["event_id"] for row in rows} == {"plan-e003-m0"}
    assert EXPLORE.table(rows).num_rows == 2


def test_who_sees_nobody_has_no_row():
    (row,) = _rows((None, SIGHTINGS[1]))
    assert (row["observer"], row["pair_id"], row["range_m"]) == (1, "plan-e003-m0-1", 2.0)


@pytest.mark.parametrize("observer", [0, 1])
def test_robot_0_of_a_row_is_its_observer(observer: int):
    row, order = _rows(SIGHTINGS)[observer], (observer, 1 - observer)
    seen = SIGHTINGS[observer]
    assert row["range_m"] == seen.range_m
    assert row["bearing_rad"] == seen.bearing_rad
    assert row["visible_fraction"] == seen.visible_fraction
    for i, robot in enumerate(order):
        true = STARTS[robot].inverse() @ TRUE[robot]
        expected = {
            f"T_w_m{i}": STARTS[robot],
            f"T_m{i}_r{i}_true": true,
            f"T_m{i}_r{i}": true @ SLAM_OFF[robot],
            f"T_m{i}_r{i}_odometry": true @ ODOMETRY_OFF[robot],
        }
        for name, pose in expected.items():
            assert row[name].as_array() == pytest.approx(pose.wrapped().as_array(), abs=1e-9), name
        assert row[f"slam_position_error_{i}_m"] == pytest.approx(0.05 * (robot + 1))
        assert row[f"slam_heading_error_{i}_rad"] == pytest.approx(0.01 * (robot + 1))
        assert row[f"odometry_position_error_{i}_m"] == pytest.approx(0.5 * (robot + 1))
        assert row[f"odometry_heading_error_{i}_rad"] == pytest.approx(0.1 * (robot + 1))
        assert row[f"trajectory_{i}"][0, 0] == robot + 1.0
        x_m, y_m = STARTS[robot].inverse() @ np.array([TRUE[robot].x_m, TRUE[robot].y_m])
        assert row[f"trajectory_{i}_true"][0] == pytest.approx([0.0, x_m, y_m, 0.2 - STARTS[robot].yaw_rad])
    between = TRUE[order[0]].inverse() @ TRUE[order[1]]
    frames = STARTS[order[0]].inverse() @ STARTS[order[1]]
    local = row["T_m0_r0"] @ between @ row["T_m1_r1"].inverse()
    for name, pose in (("T_r0_r1_true", between), ("T_m0_m1", frames), ("T_m0_m1_local", local)):
        assert np.allclose(row[name].matrix(), pose.matrix(), atol=1e-9), name
    assert row["wall_agreement_local"] == 1.0  # the one cell of both maps is at the same place
    assert row["wall_agreement"] == 0.0  # but not after the drift of both


def test_a_ghost_is_a_cell_on_the_other_robots_path():
    first, second = _rows(SIGHTINGS)
    assert (first["ghost_cells_0"], first["ghost_cells_1"]) == (1, 0)
    assert (second["ghost_cells_0"], second["ghost_cells_1"]) == (0, 1)
    assert first["occupied_cells_0"] == first["occupied_cells_1"] == 1


def test_a_row_has_its_observers_furniture_and_what_was_drawn():
    tables = tuple(solid_rows([pole(x_m, 1.0, 0.1)]) for x_m in (1.0, 2.0))
    rows = _rows(SIGHTINGS, furniture=tables, drawn=" changed=0.50")
    assert [row["furniture"] for row in rows] == list(tables)
    assert {row["episode_id"] for row in rows} == {"plan-e003 changed=0.50"}
    assert {row["event_id"] for row in rows} == {"plan-e003-m0"}


def test_what_stands_in_a_robots_own_world_is_no_ghost_in_its_map():
    ghost_m, afar_m = np.array([[3.0, 2.5, 3.2, 2.5]]), np.array([[0.0, 0.0, 5.0, 0.0]])
    first, _ = _rows(SIGHTINGS, lidar_segments_m=(ghost_m, afar_m))
    assert (first["ghost_cells_0"], first["ghost_cells_1"]) == (0, 0)
    first, _ = _rows(SIGHTINGS, lidar_segments_m=(afar_m, ghost_m))
    assert (first["ghost_cells_0"], first["ghost_cells_1"]) == (1, 0)
