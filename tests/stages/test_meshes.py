"""Walls, meshes and MJCF of floor plans, and their way out as files."""

from __future__ import annotations

import io
import json
import shutil
from importlib import import_module
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from rendezvous.commands.export.plan import export_floorplans, export_plan
from rendezvous.engine.run import Run
from rendezvous.errors import FloorplanError, StoreError
from rendezvous.floorplan.records import Floorplan, Solid
from rendezvous.floorplan.walls import wall_boxes
from rendezvous.plan_schema import plan_of, solids_of
from rendezvous.seeds import stream
from rendezvous.stages.floorplans import floorplans
from rendezvous.stages.meshes import meshes
from tests.conftest import ROOT, MakeRun, run_in

SMALL = [
    "floorplans.sources=[]",
    "floorplans.generate.count=4",
    "floorplans.generate.plans.rooms=[3, 6]",
    "floorplans.plans_per_shard=2",
]


@pytest.fixture(scope="module")
def raised(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder with four small plans, raised."""
    data = tmp_path_factory.mktemp("raised")
    run = run_in(str(data), SMALL)
    floorplans(run)
    meshes(run)
    return data


@pytest.fixture
def run(raised: Path, tmp_path: Path) -> Run:
    """A run that has raised them; each test has a copy."""
    shutil.copytree(raised, tmp_path / "data")
    return run_in(str(tmp_path / "data"), SMALL)


def said(run: Run) -> str:
    return run.console.file.getvalue()


def test_every_plan_has_its_walls_meshes_and_a_scene_that_mujoco_opens(run: Run):
    rows = list(run.read("meshes").rows())
    assert [row["plan_id"] for row in rows] == [f"gen-{index:06d}" for index in range(4)]
    for row in rows:
        plan, walls = plan_of(row), solids_of(row["walls"])
        assert walls == wall_boxes(plan, height_m=2.5)
        for column in ("glb", "glb_furnished"):
            scene = trimesh.load_scene(io.BytesIO(row[column]), file_type="glb")
            assert scene.geometry["walls"].is_watertight
            assert scene.bounds[1, 1] == pytest.approx(2.5)  # glTF's y is up
        model = mujoco.MjModel.from_xml_string(row["mjcf"])
        assert {model.body(name).name for name in ("r0", "r1")} == {"r0", "r1"}
        assert model.ngeom > len(walls) + len(row["furniture"])


def test_each_plan_draws_from_a_stream_of_its_own(make_run: MakeRun, monkeypatch: pytest.MonkeyPatch):
    draws: dict[str, float] = {}

    def furnish(plan: Floorplan, rng: np.random.Generator, **_: float) -> list[Solid]:
        draws[plan.plan_id] = rng.random()
        return []

    monkeypatch.setattr(import_module("rendezvous.stages.meshes"), "furnish", furnish)
    run = make_run(SMALL, seed=3)
    floorplans(run)
    meshes(run)
    assert len(draws) == 4
    assert draws == {plan: stream(3, "meshes", plan).random() for plan in draws}


def test_the_robots_of_the_scene_stand_free_in_it(run: Run):
    rows = list(run.read("meshes").rows())
    assert len(rows) == 4
    for row in rows:
        model = mujoco.MjModel.from_xml_string(row["mjcf"])
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        floor = model.geom("floor").id
        touching = {int(geom) for contact in data.contact[: data.ncon] for geom in contact.geom}
        robots = {model.body("r0").id, model.body("r1").id}
        scene = {g for g in touching if model.geom_bodyid[g] == 0 and g != floor}
        assert floor in touching  # on which their wheels stand
        assert scene == set()
        apart_m = np.linalg.norm(np.subtract(*[data.xpos[body][:2] for body in robots]))
        assert apart_m > 0.5


def test_a_wall_height_rebuilds_and_says_so(run: Run, make_run: MakeRun):
    taller = make_run([*SMALL, "meshes.wall_height_m=3.0"])
    meshes(taller)
    assert "meshes.wall_height_m changed 2.5 -> 3.0" in said(taller)
    assert "0 kept" in said(taller)


def test_only_plans_that_changed_are_raised_again(run: Run, make_run: MakeRun):
    more = make_run([*SMALL, "floorplans.generate.count=6"])
    floorplans(more)
    meshes(more)
    assert "1 made, 2 kept" in said(more).rpartition("meshes:")[2]


def test_what_does_not_make_a_plan_another_does_not_touch_those_who_read_it(run: Run, make_run: MakeRun):
    before = {item.item_id: item.digest for item in run.read("meshes").items()}
    meshes(make_run([*SMALL, "meshes.furniture_density=0.0"]))
    assert {item.item_id: item.digest for item in run.read("meshes").items()} == before
    meshes(make_run([*SMALL, "meshes.wall_height_m=3.0"]))
    assert all(item.digest != before[item.item_id] for item in run.read("meshes").items())


def test_meshes_without_floorplans_say_what_to_run(make_run: MakeRun):
    with pytest.raises(StoreError, match=r"floorplans: no manifest.json.*run `rendezvous floorplans` first"):
        meshes(make_run())


def test_a_plan_is_exported_as_files(run: Run, tmp_path: Path):
    paths = export_plan(run.read("meshes"), "gen-000002", tmp_path / "out")
    names = {path.name for path in paths}
    assert names == {f"gen-000002{end}" for end in (".json", ".glb", "-furnished.glb", ".xml")}
    (row,) = (row for row in run.read("meshes").rows() if row["plan_id"] == "gen-000002")
    for end, column in ((".glb", "glb"), ("-furnished.glb", "glb_furnished")):
        assert (tmp_path / "out" / f"gen-000002{end}").read_bytes() == row[column]
    assert row["glb"] != row["glb_furnished"]
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "gen-000002.xml")).nbody > 2
    assert json.loads((tmp_path / "out" / "gen-000002.json").read_text())["id"] == "gen-000002"


def test_an_unknown_plan_is_told_with_those_like_it(run: Run, tmp_path: Path):
    with pytest.raises(FloorplanError, match="no plan 'gen-00002'; there are gen-000002"):
        export_plan(run.read("meshes"), "gen-00002", tmp_path)


def test_an_exported_plan_is_the_same_plan_when_it_is_read(run: Run, make_run: MakeRun, tmp_path: Path):
    export_plan(run.read("meshes"), "gen-000001", tmp_path / "out")
    again = make_run(
        [f"floorplans.sources=[{tmp_path / 'out'}]", "floorplans.generate.count=0"],
        data=str(tmp_path / "again"),
    )
    floorplans(again)
    (row,) = again.read("floorplans").rows()
    digests = {row["plan_id"]: row["plan_digest"] for row in run.read("floorplans").rows()}
    assert row["plan_digest"] == digests["gen-000001"]


def test_the_shipped_floorplans_are_those_that_the_generator_makes(tmp_path: Path):
    paths = export_floorplans(24, tmp_path)
    assert len(paths) == 24
    for path in paths:
        assert path.read_bytes() == (ROOT / "floorplans" / path.name).read_bytes(), path.name
