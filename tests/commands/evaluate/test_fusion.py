from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

pytest.importorskip("matplotlib")
pytest.importorskip("torch")

from rendezvous.commands.evaluate import all as every
from rendezvous.commands.evaluate import fusion as stage
from rendezvous.commands.evaluate.all import EveryEvaluation, evaluate_all
from rendezvous.commands.evaluate.frame_error import evaluate
from rendezvous.commands.evaluate.fusion import FusionEvaluation, evaluate_fusion
from rendezvous.errors import ConfigError, StoreError
from rendezvous.evaluation.fusion.paper_scenario import PAPER_OVERLAP
from rendezvous.geometry.se2 import SE2
from rendezvous.stages.pack import pack
from rendezvous.stages.training.seen_images import SIGHTING, read_images
from rendezvous.store.read import StageReader
from rendezvous.training.frame_error.pairs import read_pairs
from tests.commands.evaluate.toy_evaluation import toy_dataset
from tests.evaluation.pages import require_self_contained
from tests.stages.toy_sources import ToySource
from tests.synthetic_dataset import explored, rendered, synthetic_run

SIMPLE = ("none", "correlative")


@pytest.fixture(autouse=True)
def no_charts(monkeypatch):
    """Drawing takes longer than all else; `monkeypatch.undo()` has charts drawn."""
    monkeypatch.setattr("rendezvous.evaluation.fusion.report.violin_chart", lambda *_: "a chart")


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    return toy_dataset(tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def images(data):
    return read_images(StageReader(f"{data}/dataset"), "test", kinds=(SIGHTING,))


def _evaluated(data: Path, folder: Path, source: ToySource | None, **settings) -> tuple[dict, str]:
    """What `metrics.json` holds, and what was told."""
    told = io.StringIO()
    settings = {"methods": SIMPLE, "count": 2, "records": folder / "records", **settings}
    evaluate_fusion(
        FusionEvaluation(
            dataset=f"{data}/dataset", folder=folder, source=source, console=Console(file=told), **settings
        )
    )
    return json.loads((folder / "metrics.json").read_text())["fusion"], told.getvalue()


def test_true_poses_give_true_maps_and_a_page(data, images, tmp_path, monkeypatch):
    monkeypatch.undo()
    metrics, _ = _evaluated(data, tmp_path, ToySource.of(images))
    assert set(metrics["runs"]) == {f"{source}-{m}" for source in ("estimated", "true") for m in SIMPLE}
    for source in ("estimated", "true"):
        overall = metrics["runs"][f"{source}-none"]["figures"]["overall"]
        assert overall["success"] == {"count": 2, "of": 2}
        assert overall["iou_mean"] == pytest.approx(1.0, abs=1e-3)
        assert overall["position_m"]["largest"] == pytest.approx(0.0, abs=1e-6)
    table = read_pairs(StageReader(f"{data}/dataset"), "test")
    overlaps = dict(zip(table.table["pair_id"].to_pylist(), table.overlap, strict=True))
    drawn = json.loads(next((tmp_path / "fusion").iterdir()).read_text())["rows"]
    nearest = min((row["pair_id"] for row in drawn), key=lambda name: abs(overlaps[name] - PAPER_OVERLAP))
    assert metrics["paper_scenario"]["pair_id"] == nearest
    assert metrics["paper_scenario"]["overlap"] == pytest.approx(overlaps[nearest], abs=0.02)
    page = (tmp_path / "index.html").read_text()
    anchors = require_self_contained(page)
    assert {"fusion", "fusion-methods", "fusion-gallery", "fusion-scenario"} <= anchors
    assert "so the true relative pose alone has none" in page
    assert "map 0, which is in both, makes it never zero" in page
    assert "Its maps are not public" in page


def test_maps_mend_what_the_pose_lacks_and_figures_can_be_kept(data, images, tmp_path):
    source = ToySource.of(images, off=SE2(0.35, 0.1, 0.1), sigma=0.3)
    metrics, told = _evaluated(data, tmp_path, source, record=True)
    figures = {name: row["figures"]["overall"] for name, row in metrics["runs"].items()}
    assert figures["estimated-none"]["success"]["count"] == 0
    assert figures["estimated-correlative"]["success"]["count"] == 2
    assert figures["estimated-correlative"]["iou_mean"] > figures["estimated-none"]["iou_mean"]
    assert told.count("recorded") == 4
    metrics, told = _evaluated(data, tmp_path, source, methods=("none",))
    assert {name: row["source"] for name, row in metrics["runs"].items()} == {
        "estimated-none": "measured",
        "estimated-correlative": "recorded",
        "true-none": "measured",
        "true-correlative": "recorded",
    }
    with pytest.raises(ConfigError, match=r"estimated-none\.json: recorded from 2 images, which --record"):
        _evaluated(data, tmp_path, source, methods=("none",), count=1, record=True)


def test_robots_that_are_not_found_count_and_nothing_is_measured_twice(data, images, tmp_path):
    source = ToySource.of(images, finds=False)
    metrics, _ = _evaluated(data, tmp_path, source, methods=("none",))
    overall = metrics["runs"]["estimated-none"]["figures"]["overall"]
    assert overall["made"] == {"count": 0, "of": 2}
    assert overall["success"] == {"count": 0, "of": 2}
    assert metrics["runs"]["true-none"]["figures"]["overall"]["success"]["count"] == 2
    require_self_contained((tmp_path / "index.html").read_text())
    again, told = _evaluated(data, tmp_path, source, methods=("none",))
    assert "2 pairs, as measured before" in told
    assert again["runs"] == metrics["runs"]


def test_without_a_matcher_the_learned_methods_are_left_out_unless_asked_for(
    data, images, tmp_path, monkeypatch
):
    def none() -> None:
        raise ConfigError("matcher: no weights")

    monkeypatch.setattr(stage, "selected_matcher", none)
    source = ToySource.of(images)
    metrics, told = _evaluated(data, tmp_path, source, methods=(), count=1)
    assert "learned, auto left out: matcher: no weights" in told
    assert "estimated-orb" in metrics["runs"]
    assert "estimated-auto" not in metrics["runs"]
    with pytest.raises(ConfigError, match="matcher: no weights"):
        _evaluated(data, tmp_path, source, methods=("auto",))


def test_an_unknown_method_is_told_in_one_line(data, images, tmp_path):
    with pytest.raises(ConfigError, match="method 'icp' is unknown; must be one of none, hough, orb, "):
        _evaluated(data, tmp_path, ToySource.of(images), methods=("icp",))


@pytest.fixture(scope="module")
def unseen(tmp_path_factory) -> Path:
    """A dataset without images."""
    folder = tmp_path_factory.mktemp("unseen")
    explored(folder)
    rendered(folder, views=False, poses=())
    pack(synthetic_run(folder))
    return folder


def test_a_dataset_without_images_is_told_in_one_line(unseen, tmp_path):
    with pytest.raises(StoreError, match="no sighting images of split test; must be a dataset whose images"):
        _evaluated(unseen, tmp_path, None)


def test_what_cannot_run_is_left_out_of_all_evaluations_and_told(unseen, tmp_path, monkeypatch):
    monkeypatch.setattr(every, "evaluate", lambda s: evaluate(replace(s, methods=("identity",))))
    told = io.StringIO()
    settings = EveryEvaluation(
        dataset=f"{unseen}/dataset", count=1, folder=tmp_path, console=Console(file=told)
    )
    page = evaluate_all(settings)
    assert "left out: relative pose: " in told.getvalue()
    assert "left out: fusion: " in told.getvalue()
    assert "left out: frame error" not in told.getvalue()
    assert set(json.loads((tmp_path / "metrics.json").read_text())) == {"frame_error"}
    assert page.is_file()
    with pytest.raises(ConfigError, match="no evaluation could run"):
        evaluate_all(EveryEvaluation(dataset=f"{tmp_path}/none", folder=tmp_path, console=Console(file=told)))
