"""Every option of a command arrives where it belongs, with its own value."""

from __future__ import annotations

import os
import shlex
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from rendezvous.cli import evaluate as evaluate_commands
from rendezvous.cli import train as train_commands
from rendezvous.cli.__main__ import app
from rendezvous.commands.export.dataset_images import ImageTable, Split
from rendezvous.commands.inspect import Inspection, Order, Selection, ShownTable
from rendezvous.config.load import load_config
from rendezvous.engine.pool import Engine
from rendezvous.engine.run import Run
from rendezvous.errors import ConfigError
from tests.conftest import ROOT


class Called:
    """Stands in for what a command calls, and keeps its arguments."""

    def __init__(self, answer: Any = None) -> None:
        self.answer = answer
        self.arguments: tuple[Any, ...] = ()
        self.options: dict[str, Any] = {}

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        self.arguments, self.options = arguments, options
        return self.answer


def run(command: str) -> str:
    shown = CliRunner().invoke(app, shlex.split(command), catch_exceptions=False)
    assert shown.exit_code == 0, shown.output
    return shown.stdout


EVALUATIONS = [
    (
        "frame_error.evaluate",
        "evaluate --data d/ --split train --count 3 --methods 'a, b' --weights n=w --weights m=v"
        " --xy-range-m 1.5 --yaw-range-deg 20 --seed 7 --report r --record --records k --workers 2",
        {
            "dataset": "d/dataset", "split": "train", "count": 3, "methods": ("a", "b"),
            "weights": {"n": Path("w"), "m": Path("v")}, "xy_range_m": 1.5, "yaw_range_deg": 20.0, "seed": 7,
            "folder": Path("r"), "record": True, "records": Path("k"), "workers": 2,
        },
    ),
    (
        "relative_pose.evaluate_pose",
        "evaluate-pose --data d --split train --count 3 --images sighting --weights w --no-floor --unseen"
        " --seed 7 --report r --record --records k --workers 2",
        {
            "dataset": "d/dataset", "split": "train", "count": 3, "kinds": ("sighting",),
            "weights": Path("w"), "floor": False, "unseen": True, "seed": 7, "folder": Path("r"),
            "record": True, "records": Path("k"), "workers": 2,
        },
    ),
    (
        "fusion.evaluate_fusion",
        "evaluate-fusion --data d --split train --count 3 --methods none,auto --weights w --unseen --seed 7"
        " --report r --record --records k --workers 2",
        {
            "dataset": "d/dataset", "split": "train", "count": 3, "methods": ("none", "auto"),
            "weights": Path("w"), "unseen": True, "seed": 7, "folder": Path("r"), "record": True,
            "records": Path("k"), "workers": 2,
        },
    ),
    (
        "all.evaluate_all",
        "evaluate-all --data d --split train --count 3 --report r --workers 2",
        {"dataset": "d/dataset", "split": "train", "count": 3, "folder": Path("r"), "workers": 2},
    ),
]  # fmt: skip


@pytest.mark.parametrize(("target", "command", "expected"), EVALUATIONS)
def test_an_evaluation_is_asked_for_what_is_given(monkeypatch, target, command, expected):
    evaluated = Called("a page")
    monkeypatch.setattr(f"rendezvous.commands.evaluate.{target}", evaluated)
    assert run(command) == "a page\n"
    (asked,) = evaluated.arguments
    assert {name: getattr(asked, name) for name in expected} == expected


@pytest.mark.parametrize(("target", "command", "expected"), EVALUATIONS)
def test_an_evaluation_without_options_is_that_of_its_own_defaults(monkeypatch, target, command, expected):
    evaluated = Called("a page")
    monkeypatch.setattr(f"rendezvous.commands.evaluate.{target}", evaluated)
    run(command.split()[0])
    (asked,) = evaluated.arguments
    cores = {"workers": len(os.sched_getaffinity(0))}
    own = type(asked)(**({"records": asked.records} if "records" in expected else {}), **cores)
    if target == "relative_pose.evaluate_pose":  # the kinds in words
        assert set(asked.kinds) == set(own.kinds)
        expected = expected.keys() - {"kinds"}
    found, wanted = ({name: getattr(of, name) for name in {*expected} - {"dataset"}} for of in (asked, own))
    assert found == wanted
    assert asked.dataset == "data/dataset"


def test_figures_are_kept_in_the_checkout_or_where_they_are_told_to(monkeypatch):
    shipped, told = Path("shipped"), Path("told")
    records = evaluate_commands._records
    assert records(None, shipped, record=True) == records(None, shipped, record=False) == shipped
    monkeypatch.setattr(evaluate_commands, "IN_CHECKOUT", False)
    assert records(None, shipped, record=False) == shipped
    assert records(told, shipped, record=True) == told
    with pytest.raises(ConfigError, match="--record: would write to the installed package; --records names"):
        records(None, shipped, record=True)


def _run_of(called: Called) -> dict[str, Any]:
    """What a stage is run with."""
    (asked,) = called.arguments
    assert isinstance(asked, Run)
    return {"data": asked.data, "workers": asked.workers, "engine": asked.engine, "config": asked.config}


@pytest.mark.parametrize("stage", ["floorplans", "meshes", "explore", "render", "pack"])
def test_a_stage_is_run_with_what_is_given(monkeypatch, stage):
    made = Called()
    monkeypatch.setattr(f"rendezvous.stages.{stage}.{stage}", made)
    sets = ("explore.episodes_per_plan=9", "floorplans.generate.count=5")
    run(
        f"{stage} --config {ROOT}/stages.yaml --preset large --set {sets[0]} --set {sets[1]} --data d"
        " --workers 3 --seed 0 --engine inline"
    )
    config = load_config(ROOT / "stages.yaml", preset="large", overrides=sets, seed=0)
    assert _run_of(made) == {"data": "d", "workers": 3, "engine": Engine.INLINE, "config": config}


@pytest.mark.parametrize(
    ("command", "own", "sets"),
    [
        ("train", "--model vit-reg-lie", ["train.model=vit-reg-lie", "train.minutes=4"]),
        ("train-pose", "", ["train_pose.minutes=4"]),
    ],
)
def test_a_training_is_run_with_what_is_given(monkeypatch, command, own, sets):
    trained = Called()
    monkeypatch.setattr(train_commands, "stage_function", {command.replace("-", "_"): trained}.__getitem__)
    run(
        f"{command} {own} --minutes 4 --resume --out o --config {ROOT}/stages.yaml --preset smoke --data d"
        " --set explore.episodes_per_plan=9 --workers 3 --seed 0"
    )
    overrides = ["explore.episodes_per_plan=9", *sets]
    config = load_config(ROOT / "stages.yaml", preset="smoke", overrides=overrides, seed=0)
    assert _run_of(trained) == {"data": "d", "workers": 3, "engine": Engine.LOCAL, "config": config}
    assert trained.options == {"out": Path("o"), "resume": True}


@pytest.mark.parametrize("name", ["train", "train-pose"])
def test_an_interrupted_training_says_how_to_go_on(monkeypatch, name):
    def interrupted(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(train_commands, "stage_function", lambda stage: interrupted)
    shown = CliRunner().invoke(app, [name, "--config", str(ROOT / "stages.yaml")])
    assert shown.exit_code == 130
    assert shown.stderr == "rendezvous: interrupted; --resume continues from the last checkpoint\n"


@pytest.mark.parametrize("name", ["calibrate", "calibrate_pose"])
def test_a_calibration_is_run_with_what_is_given(monkeypatch, tmp_path, name):
    calibrated, weights = Called(), tmp_path / "weights"
    weights.touch()
    monkeypatch.setattr(f"rendezvous.stages.training.{name}.{name}", calibrated)
    run(f"{name.replace('_', '-')} {weights} --data d --seed 7 --workers 3")
    assert calibrated.arguments == (weights, "d/dataset")
    assert calibrated.options | {"console": None} == {"seed": 7, "threads": 3, "console": None}


def test_inspect_draws_what_is_given(monkeypatch):
    inspected = Called(Inspection(summary="figures", pictures=(Path("o.png"),)))
    monkeypatch.setattr("rendezvous.commands.inspect.inspect", inspected)
    assert (
        run("inspect d --out o.png --table poses --count 3 --order random --seed 7") == "figures\n\no.png\n"
    )
    assert inspected.arguments == ("d",)
    assert inspected.options == {
        "output": Path("o.png"),
        "table": ShownTable.POSES,
        "selection": Selection(count=3, order=Order.RANDOM, seed=7),
    }
    run("inspect")
    assert inspected.arguments == ("data/dataset",)
    assert inspected.options == {"output": None, "table": None, "selection": Selection()}


@pytest.mark.parametrize(("kind", "more"), [("dope", {}), ("bop", {"robot": "r.yaml"})])
def test_an_export_of_images_is_asked_for_what_is_given(monkeypatch, kind, more):
    exported = Called(SimpleNamespace(summary=lambda: "what was written"))
    monkeypatch.setattr(f"rendezvous.commands.export.{kind}.export_{kind}", exported)
    words = "".join(f" --{name} {value}" for name, value in more.items())
    assert run(f"export {kind} d --out o --table pairs --split test --count 3{words}") == "what was written\n"
    assert exported.arguments == ("d", Path("o"))
    del exported.options["console"]
    assert exported.options == {"table": ImageTable.PAIRS, "split": Split.TEST, "count": 3, **more}


def test_a_sighting_is_that_which_is_given(monkeypatch):
    exported = Called("a command")
    monkeypatch.setattr("rendezvous.commands.export.sighting.export_sighting", exported)
    assert run("export sighting d --out o --pair p") == "a command\n"
    assert exported.arguments == ("d", "p", Path("o"))


def test_plans_are_as_many_as_asked_for(monkeypatch):
    exported = Called([Path("a"), Path("b")])
    monkeypatch.setattr("rendezvous.commands.export.plan.export_floorplans", exported)
    assert run("export floorplans --count 2 --out o") == "2 floor plans in o\n"
    assert exported.arguments == (2, Path("o"))


def test_a_fusion_is_asked_for_what_is_given(monkeypatch):
    fused = Called("a result")
    monkeypatch.setattr("rendezvous.commands.fuse.from_python.fuse", fused)
    monkeypatch.setattr("rendezvous.commands.fuse.outputs.summary", lambda result, out: f"{result} in {out}")
    common = "fuse --map0 a --map1 b --pose0 1,2,3 --pose1 4,5,6 --robot r --refine none"
    more = "--merge probabilistic --strict --out o"
    sights = "--image i --image j --camera c --camera-pose 1,2,3,4,5,6"
    assert run(f"{common} {sights} {more}") == "a result in o\n"
    seen = {
        "pose0": (1.0, 2.0, 3.0),
        "pose1": (4.0, 5.0, 6.0),
        "image": [Path("i"), Path("j")],
        "camera": Path("c"),
        "camera_pose": (1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
        "robot": "r",
        "relative": None,
        "relative_sigma": None,
        "refine": "none",
        "merge": "probabilistic",
        "strict": True,
        "out": Path("o"),
    }
    assert fused.arguments == (Path("a"), Path("b"))
    assert fused.options == seen
    run(f"{common} --relative=-1,2,3 --relative-sigma 1,2,180 {more}")
    told = {"relative": (-1.0, 2.0, 3.0), "relative_sigma": (1.0, 2.0, pytest.approx(3.14159265))}
    assert fused.options == seen | told | dict.fromkeys(("image", "camera", "camera_pose"))


def test_a_folder_to_write_to_that_is_a_file_is_told_before_anything_is_read(tmp_path):
    (tmp_path / "taken").touch()
    words = shlex.split("fuse --map0 a --map1 b --pose0 1,2,3 --pose1 4,5,6 --relative 1,2,3 --out")
    shown = CliRunner().invoke(app, [*words, str(tmp_path / "taken")])
    assert shown.exit_code == 2
    assert f"--out is '{tmp_path / 'taken'}', a file; must be a folder" in shown.stderr


def test_options_of_see_arrive(monkeypatch, tmp_path):
    called = Called([])
    monkeypatch.setattr("rendezvous.commands.see.see", called)
    written = Called([Path("p.png")])
    monkeypatch.setattr("rendezvous.commands.see.write_seen", written)
    shown = run(
        f"see a.png b.png --camera c.yaml --camera-pose 1,2,3,4,5,6 --robot waffle --out {tmp_path}/o"
    )
    assert called.arguments == ([Path("a.png"), Path("b.png")], Path("c.yaml"))
    assert called.options == {"camera_pose": (1.0, 2.0, 3.0, 4.0, 5.0, 6.0), "robot": "waffle"}
    assert written.arguments == ([], tmp_path / "o")
    assert shown == "p.png\n"
