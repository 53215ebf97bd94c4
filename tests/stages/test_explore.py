from __future__ import annotations

import re
from copy import deepcopy
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from rendezvous.engine.run import Run
from rendezvous.errors import ConfigError, FloorplanError
from rendezvous.exploration.records import Episode
from rendezvous.exploration.starts import draw_starts
from rendezvous.floorplan.furnish import furnish
from rendezvous.geometry.se2 import SE2
from rendezvous.plan_schema import plan_of, solids_of
from rendezvous.robot_file import LIDARS, ROBOTS, load_robot
from rendezvous.schema import EXPLORE
from rendezvous.seeds import stream
from rendezvous.stages.dataset.episode_draws import draw_lidars, in_words
from rendezvous.stages.explore import explore
from rendezvous.stages.floorplans import floorplans
from rendezvous.stages.meshes import meshes
from tests.conftest import MakeRun, run_in

ONE_PLAN = (
    "floorplans.sources=[floorplans/rdv-008.json]",
    "floorplans.generate.count=0",
    "explore.episodes_per_plan=2",
    "explore.episode.max_time_s=60",
)


def prepared(make_run: MakeRun, *overrides: str):
    run = make_run([*ONE_PLAN, *overrides])
    floorplans(run)
    meshes(run)
    return run


@pytest.fixture(scope="module")
def explored(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run that has explored a plan twice."""
    run = run_in(str(tmp_path_factory.mktemp("explored")), ONE_PLAN)
    for stage in (floorplans, meshes, explore):
        stage(run)
    return run


def test_counts_add_up_and_each_sighting_is_a_row(explored: Run) -> None:
    run = explored
    counts = run.read("explore").manifest().counts()
    table = run.read("explore").table("part-00000.parquet")
    rows = EXPLORE.rows(table)
    assert counts["episodes"] + counts["episodes_left_out"] == 2
    assert counts["pairs"] == len(rows) > 0
    assert counts["events"] == len({row["event_id"] for row in rows})
    assert counts["episodes_without_meeting"] == 2 - len({row["episode_id"] for row in rows})
    assert len({row["pair_id"] for row in rows}) == len(rows)
    assert all(row["furniture"] for row in rows)


def test_more_episodes_leave_the_first_ones_as_they_were(explored: Run, make_run: MakeRun) -> None:
    many = prepared(make_run, "explore.episodes_per_plan=3")
    before = {row["pair_id"]: row["map_0"] for row in explored.read("explore").rows()}
    assert before
    explore(many)
    after = {row["pair_id"]: row["map_0"] for row in many.read("explore").rows()}
    assert before.items() <= after.items()


def test_each_episode_has_starts_furniture_and_noise_of_its_own(
    make_run: MakeRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And they come from streams keyed by plan and number, in whatever order episodes are run."""
    module = import_module("rendezvous.stages.explore")
    draws: dict[str, list[float]] = {"furniture": [], "starts": [], "episode": []}
    places, asked = list[tuple[float, float]](), dict[str, float]()

    def furnished(plan, rng, **density):
        draws["furniture"].append(deepcopy(rng).random())
        return furnish(plan, rng, **density)

    def drawn(*given, rng, **keywords) -> tuple[SE2, SE2]:
        draws["starts"].append(deepcopy(rng).random())
        asked.update(keywords)
        return draw_starts(*given, rng=rng, **keywords)

    def stands(surroundings, robots, starts, parameters, *, rng) -> Episode:
        draws["episode"].append(rng.random())
        places.extend((start.x_m, start.y_m) for start in starts)
        return Episode(events=(), simulated_s=12.4, last=())  # type: ignore[arg-type]

    for name, spy in (("furnish", furnished), ("draw_starts", drawn), ("run_episode", stands)):
        monkeypatch.setattr(module, name, spy)
    run = prepared(make_run, "explore.episodes_per_plan=4")
    counts = explore(run).counts()
    assert counts["episodes"] == counts["episodes_without_meeting"] == 4
    assert counts["simulated_s"] == 4 * 12
    assert len(set(places)) == 8
    assert draws == {
        name: [stream(0, "explore", "rdv-008", number, name).random() for number in range(4)]
        for name in draws
    }
    radius_m = load_robot("burger").radius_m
    assert asked == {
        "clearance_m": radius_m + 0.115,
        "passage_m": radius_m + run.config.explore.episode.explorer.hard_margin_m,
        "least_distance_m": 2.0,
    }


def test_when_no_episode_can_be_run_it_says_why(make_run: MakeRun) -> None:
    run = prepared(make_run, "explore.start_distance_m=1000.0")
    with pytest.raises(FloorplanError, match=r"2 episodes left out, .* 1000\.0 m apart .*no episode"):
        explore(run)
    assert run.read("explore").manifest().counts()["episodes_left_out"] == 2


@pytest.mark.slow
def test_another_robot_explores_as_well(make_run: MakeRun, tmp_path: Path) -> None:
    """Half as large again, with a lidar of 720 beams at 10 Hz that sees 2.5 m."""
    text = (ROBOTS / "burger" / "robot.yaml").read_text()
    changes = {
        "name: burger": "name: cart",
        "size_m: [0.138, 0.178, 0.192]": "size_m: [0.207, 0.267, 0.192]",
        "radius_m: 0.105": "radius_m: 0.145",
        "mass_kg: 1.0": "mass_kg: 2.0",
        "radius_m: 0.069": "radius_m: 0.100",
        "track_m: 0.160": "track_m: 0.240",
        "beams: 360": "beams: 720",
        "rate_hz: 5.0": "rate_hz: 10.0",
        "range_max_m: 3.5": "range_max_m: 2.5",
    }
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "cart.yaml").write_text(text)
    run = prepared(
        make_run,
        f"explore.robot={tmp_path / 'cart.yaml'}",
        "explore.furniture_density=0.3",
        "explore.episode.max_time_s=150",
    )
    explore(run)
    rows = list(run.read("explore").rows(columns=["slam_position_error_0_m", "T_r1_o"]))
    assert rows
    assert max(row["slam_position_error_0_m"] for row in rows) < 0.1


def test_a_cylinder_is_an_octagon_in_what_the_lidar_sees() -> None:
    module = import_module("rendezvous.stages.explore")
    wall_m = np.array([[0.0, 0.0, 4.0, 0.0]])
    outline_m = module._outline(wall_m, np.array([[1.0, 2.0, 0.5], [3.0, 1.0, 0.1]]))
    assert outline_m.shape == (1 + 2 * 8, 4)
    assert outline_m[0].tolist() == wall_m[0].tolist()
    turns = np.radians(45.0 * np.arange(8))
    corners_m = np.array([1.0, 2.0]) + 0.5 * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    np.testing.assert_allclose(outline_m[1:9, :2], corners_m)
    np.testing.assert_allclose(outline_m[1:9, 2:], np.roll(corners_m, -1, axis=0))
    np.testing.assert_allclose(np.hypot(*(outline_m[9:, :2] - [3.0, 1.0]).T), 0.1)


def test_without_a_choice_a_shard_depends_on_nothing_new(explored: Run) -> None:
    """Shards of earlier versions are kept."""
    (shard,) = explored.read("explore").shards()
    new = ("explore.lidar", "explore.changed", "explore.robot.lidar.field", "explore.robot.lidar.turn")
    assert [key for key in shard.inputs.parameters if key.startswith(new)] == []
    assert {row["episode_id"] for row in explored.read("explore").rows()} <= {"rdv-008-e000", "rdv-008-e001"}


def test_lidars_and_changed_scenes_are_drawn_and_named_in_the_rows(make_run: MakeRun) -> None:
    run = prepared(
        make_run,
        "explore.lidar={hokuyo-ust-10lx: 1, sick-lms: 3}",
        "explore.changed_share=1",
        "explore.episode.drive=planar",
        "explore.episode.sighting.max_range_m=8",
    )
    explore(run)
    (shard,) = run.read("explore").shards()
    assert shard.inputs.parameters["explore.lidar.sick-lms.weight"] == 3.0
    assert shard.inputs.parameters["explore.lidar.sick-lms.noise.step_m"] == 0.01
    rows = list(run.read("explore").rows())
    assert rows
    for row in rows:
        said = re.fullmatch(r"rdv-008-e00(\d) lidars=(\S+),(\S+) changed=(0\.\d\d)", row["episode_id"])
        assert said, row["episode_id"]
        assert {said[2], said[3]} <= {"hokuyo-ust-10lx", "sick-lms"}
        assert 0.3 <= float(said[4]) <= 0.6
        key = ("explore", "rdv-008", int(said[1]))
        assert draw_lidars(run.config.explore.lidar, rng=stream(0, *key, "lidars")) == (said[2], said[3])
        plan = next(plan_of(row) for row in run.read("meshes").rows())
        before = furnish(
            plan, stream(0, *key, "furniture"), density=1.0, robot_radius_m=load_robot("burger").radius_m
        )
        kept = [solid for solid in solids_of(row["furniture"]) if solid in set(before)]
        if row["observer"] == 0:
            assert tuple(solids_of(row["furniture"])) == before
        else:
            assert 0.3 * len(before) < len(kept) < 0.8 * len(before)


def test_lidars_are_drawn_by_their_weights_and_half_of_the_time_as_one() -> None:
    drawn = [draw_lidars({"a": 1.0, "b": 3.0, "c": 0.0}, rng=stream(0, "draw", k)) for k in range(2000)]
    assert {name for pair in drawn for name in pair} == {"a", "b"}
    assert np.mean([first == "a" for first, _ in drawn]) == pytest.approx(0.25, abs=0.04)
    assert np.mean([second == "a" for _, second in drawn]) == pytest.approx(0.25, abs=0.04)
    # Alike: half of them, and of the others those that drew the same, 1/16 and 9/16.
    assert np.mean([first == second for first, second in drawn]) == pytest.approx(0.5 + 0.5 * 0.625, abs=0.04)
    assert draw_lidars({}, rng=stream(0, "draw")) == (None, None)


def test_what_was_drawn_is_told_without_paths() -> None:
    assert in_words((None, None), None) == ""
    assert in_words(("home/my lidars/mine.yaml", "sick-lms"), 0.417) == " lidars=mine,sick-lms changed=0.42"


def test_a_lidar_of_ones_own_that_cannot_be_is_named(make_run: MakeRun, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text((LIDARS / "sick-lms.yaml").read_text().replace("rate_hz: 5.0", "rate_hz: 7.0"))
    with pytest.raises(ConfigError, match=r"\Aexplore\.lidar: .*mine\.yaml: .*rate_hz is 7\.0; must divide"):
        explore(make_run([*ONE_PLAN, f"explore.lidar={path}"]))


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("explore.lidar=sick", r"\Alidar 'sick': no file .*; known lidars are hokuyo-ust-10lx, .*\Z"),
        ("explore.lidar={sick-lms: 1, a/sick-lms.yaml: 1}", r"explore\.lidar: two lidars of one name; .*\Z"),
        ("explore.lidar={sick-lms: 0}", r"explore\.lidar: all weights are 0; one must be above\Z"),
        (
            "explore.lidar={sick-lms: -1}",
            r"explore\.lidar\.sick-lms is -1.*must be greater than or equal to 0\Z",
        ),
        ("explore.lidar=[sick-lms]", r"explore\.lidar is \['sick-lms'\]; must be .*\Z"),
        ("explore.changed_share=1.5", r"explore\.changed_share is 1\.5; must be less than or equal to 1\Z"),
        ("explore.changed_furniture=[0.6, 0.3]", r"changed_furniture is \[0\.6, 0\.3\]; must be two rising"),
    ],
)
def test_a_wrong_choice_is_one_line(make_run: MakeRun, override: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        explore(make_run([*ONE_PLAN, override]))
