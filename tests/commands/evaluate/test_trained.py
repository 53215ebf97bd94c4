from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

pytest.importorskip("matplotlib")
pytest.importorskip("torch")

from rendezvous.alignment.frame_error import pose_difference
from rendezvous.alignment.window import DEFAULT_SEARCH, SearchRange
from rendezvous.cli.__main__ import app
from rendezvous.errors import StoreError
from rendezvous.geometry.se2 import SE2
from rendezvous.models.matcher_estimator import MatcherEstimator
from rendezvous.stages.weights.estimators import select_methods, training_of
from rendezvous.training.frame_error.pairs import (
    PerturbationRange,
    evaluation_perturbation,
    perturbed_pair,
    read_pairs,
)
from rendezvous.training.frame_error.registry import build_model
from rendezvous.training.parameters import Sampling
from tests.commands.evaluate.toy_evaluation import (
    TINY_MATCHER,
    TINY_VIT,
    evaluated,
    mean_error,
    toy_dataset,
    trained_weights,
)
from tests.synthetic_dataset import synthetic_run


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    return toy_dataset(tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def network(tmp_path_factory) -> Path:
    """Weights of a tiny transformer."""
    return trained_weights(tmp_path_factory.mktemp("vit-lie"), "vit-lie", TINY_VIT)


def test_weights_that_happen_to_lie_in_runs_are_left_out_if_they_cannot_be_used(data, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    trained_weights(tmp_path / "runs" / "vit", "vit-lie", TINY_VIT)
    given = ["evaluate", "--data", str(data), "--count", "2", "--workers", "1", "--records", str(tmp_path)]
    shown = CliRunner().invoke(app, given)
    assert shown.exit_code == 0, shown.stderr
    assert "left out vit: runs/vit/weights.safetensors: weights of 'vit-lie'; must be" in shown.stderr
    told = json.loads((tmp_path / "report" / "metrics.json").read_text())["frame_error"]["methods"]
    assert "vit" not in told
    assert {"correlative", "matcher"} <= set(told)
    asked = CliRunner().invoke(app, [*given, "--methods", "vit"])
    assert asked.exit_code == 2


@pytest.mark.parametrize(
    ("name", "settings", "sampling"),
    [
        ("vit-lie", TINY_VIT, {"window_cells": 192}),
        ("vit-lie", TINY_VIT, {"window_cells": 192, "window_cell_m": 0.1}),
        ("matcher", TINY_MATCHER, {"window_cell_m": 0.1}),
    ],
)
def test_a_network_trained_on_another_window_is_refused(data, tmp_path, name, settings, sampling):
    weights = trained_weights(tmp_path / "run", name, settings, **sampling)
    given = ["evaluate", "--data", str(data), "--methods", name, "--report", str(tmp_path / "r")]
    result = CliRunner().invoke(app, [*given, "--weights", f"{name}={weights}", "--workers", "1"])
    assert result.exit_code == 2
    cells, cell_m = sampling.get("window_cells", 384), sampling.get("window_cell_m", 0.05)
    assert f"trained on windows of {cells} cells of {cell_m} m; must be 384 of 0.05 m" in result.stderr
    assert not (tmp_path / "r").exists()


def test_a_trained_network_is_measured_with_its_history_and_its_attention(network, data, tmp_path):
    metrics, _ = evaluated(data, tmp_path, "identity", "vit-lie", count=2, weights={"vit-lie": network})
    training = metrics["methods"]["vit-lie"]["training"]
    assert (training["seed"], training["samples"], training["minutes"]) == (3, 16, 0.5)
    assert (training["pairs"], training["plans"], training["data"]) == (7, 2, "somewhere")
    page = (tmp_path / "index.html").read_text()
    assert "has not learned" in page
    assert "What the transformer looks at" in page
    assert "Error against training samples" in page
    assert page.count("not trained") == 7 + page.split("<tbody>")[0].count("not trained")


@pytest.mark.parametrize(
    ("name", "kept", "said"),
    [
        ("vit-lie", 4000, "bytes that are no whole checkpoint"),
        ("cnn", None, "weights of 'vit-lie'; must be those of 'cnn'"),
    ],
)
def test_weights_that_cannot_be_used_are_told(network, data, tmp_path, name, kept, said):
    path = tmp_path / "w.safetensors"
    path.write_bytes(network.read_bytes()[:kept])
    given = ["evaluate", "--data", str(data), "--methods", f"identity,{name}"]
    given += ["--report", str(tmp_path / "r"), "--workers", "1"]
    result = CliRunner().invoke(app, [*given, "--weights", f"{name}={path}"])
    assert result.exit_code == 2
    assert said in result.stderr
    assert not (tmp_path / "r").exists(), "something was measured before"


def test_a_network_that_knows_the_measured_plans_is_told_and_marked(data, tmp_path):
    plans = sorted(set(read_pairs(synthetic_run(data).read("pack"), "test").table["plan_digest"].to_pylist()))
    assert len(plans) > 2
    weights = trained_weights(
        tmp_path / "run", "vit-lie", TINY_VIT, trained_on=(plans[0][:12], plans[2][:12], "f" * 12)
    )
    given = {"weights": {"vit-lie": weights}, "records": tmp_path / "records"}
    metrics, told = evaluated(data, tmp_path, "identity", "vit-lie", record=True, **given)
    assert told.count("trained on 2 of these") == 1
    assert f"warning: trained on 2 of these {len(plans)} floor plans" in told
    for _ in ("measured", "recorded"):
        rows = metrics["methods"]
        assert (rows["vit-lie"]["plans_trained_on"], rows["identity"]["plans_trained_on"]) == (2, None)
        assert f"trained on 2 of these {len(plans)} plans</span>" in (tmp_path / "index.html").read_text()
        metrics, _ = evaluated(data, tmp_path, "identity", count=2, **given)
    assert metrics["methods"]["vit-lie"]["source"] == "recorded"


def test_the_curve_of_another_run_is_not_shown(network, data, tmp_path):
    weights, curve = tmp_path / "vit-lie.safetensors", tmp_path / "vit-lie.curve.json"
    weights.write_bytes(network.read_bytes())
    told = json.loads((network.parent / "curve.json").read_text())
    for seed, minutes in ((told["seed"], 0.5), (99, None)):
        curve.write_text(json.dumps({**told, "seed": seed}))
        metrics, _ = evaluated(data, tmp_path / "r", "vit-lie", count=1, weights={"vit-lie": weights})
        assert metrics["methods"]["vit-lie"]["training"]["minutes"] == minutes


def test_the_curve_that_weights_tell_needs_no_file_beside_them(network):
    data = {"folder": "f", "pairs": {"train": 7}, "plans": {"train": 2}}
    points = json.loads((network.parent / "curve.json").read_text())["curve"]
    record = {"model": "vit-lie", "seed": 5, "samples": 32, "data": data}
    record["curve"] = [{**points[0], "elapsed_s": 90.0}]
    (method,) = select_methods(("vit-lie",), {"vit-lie": network}, search=DEFAULT_SEARCH)
    assert training_of(method, record).minutes == 1.5
    assert training_of(method, {**record, "curve": []}).curve is None
    with pytest.raises(StoreError, match="no record of its training"):
        training_of(method, {**record, "curve": [{"samples": 3}]})


@pytest.fixture(scope="module")
def matched(data, tmp_path_factory):
    """The folder of a report on a tiny matcher, with and without where the robots stood, and its figures."""
    folder = tmp_path_factory.mktemp("matcher")
    weights = trained_weights(folder / "run", "matcher", TINY_MATCHER)
    metrics, _ = evaluated(data, folder, "matcher-maps", "matcher", count=3, weights={"matcher": weights})
    return folder, metrics


@pytest.mark.parametrize("name", ["matcher-maps", "matcher"])
def test_the_matcher_is_measured_by_its_own_posterior(matched, data, name):
    folder, metrics = matched
    drawn = json.loads((folder / "perturbations.json").read_text())["pairs"]
    network = build_model("matcher", TINY_MATCHER, Sampling(), seed=0).network.eval()
    search = SearchRange.covering(xy_m=2.0, yaw_rad=math.pi / 4)
    estimator = MatcherEstimator(model=network, search=search, uses_sight=name == "matcher")
    table = read_pairs(synthetic_run(data).read("pack"), "test")
    errors, densities = [], []
    for pair in (table[i] for i in range(len(table))):
        if pair.pair_id not in drawn:
            continue
        turn = SE2(0.0, 0.0, drawn[pair.pair_id]["rotation_rad"])
        theta = turn.inverse() @ SE2(**drawn[pair.pair_id]["theta_c"]) @ turn
        perturbation = evaluation_perturbation(pair.pair_id, PerturbationRange(), seed=0)
        window = perturbed_pair(pair, perturbation).window
        errors.append(pose_difference(estimator(window).theta, theta).as_array())
        posterior = estimator.posterior(window)
        densities.append([posterior.log_density(pose) for pose in (theta, theta.inverse())])
    assert len(errors) == 3
    found = metrics["methods"][name]["summary"]
    assert mean_error(metrics, name) == pytest.approx(np.abs(errors).mean(axis=0), rel=1e-6)
    right, inverse = -np.mean(densities, axis=0)
    assert found["calibration"]["posterior_nll"] == pytest.approx(right, rel=1e-6)
    assert abs(inverse - right) > 1e-3


def test_the_matcher_looks_at_where_the_robots_stood_only_where_it_is_to(matched):
    _, metrics = matched
    alone, told = (
        metrics["methods"][name]["summary"]["calibration"]["posterior_nll"]
        for name in ("matcher-maps", "matcher")
    )
    assert abs(alone - told) > 1e-4
