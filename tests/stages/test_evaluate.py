from __future__ import annotations

import io
import json
import shutil
import sys
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

pytest.importorskip("matplotlib")

from pipeline.cli import app
from pipeline.errors import SetupError, StoreError
from pipeline.stages import measured_pairs
from pipeline.stages.estimators import Method, chosen_methods
from pipeline.stages.evaluate import Evaluation, evaluate
from pipeline.stages.pack import pack
from pipeline.training.pairs import read_pairs
from pipeline.training.perturbation import PerturbationRange, evaluation_perturbation, perturbed_pair
from tests.synthetic_dataset import explored, synthetic_run


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    explored(folder)
    pack(synthetic_run(folder))
    return folder


def _evaluate(data: Path, folder: Path, *methods: str, **settings) -> tuple[dict, str]:
    """What `metrics.json` holds, and what was told."""
    told = io.StringIO()
    evaluate(
        Evaluation(
            dataset=f"{data}/dataset",
            methods=methods,
            folder=folder,
            records=settings.pop("records", folder / "records"),
            console=Console(file=told),
            **settings,
        )
    )
    return json.loads((folder / "metrics.json").read_text())["frame_error"], told.getvalue()


def _mean(metrics: dict, method: str) -> list[float]:
    return [m["value"] for m in metrics["methods"][method]["summary"]["overall"]["mean"]]


@pytest.fixture(scope="module")
def shown(data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    (folder / "metrics.json").write_text('{"fusion": {"kept": 1}, "frame_error": {"stale": 1}}')
    options = ["--data", str(data), "--count", "5", "--methods", "identity, correlative", "--workers", "1"]
    options += ["--report", str(folder), "--records", str(folder / "records"), "--record"]
    return folder, CliRunner().invoke(app, ["evaluate", *options])


def test_the_command_writes_the_page_and_the_figures(shown):
    folder, result = shown
    assert result.exit_code == 0, result.output
    assert f"{folder}/index.html" in result.stdout.replace("\n", "")
    page = (folder / "index.html").read_text()
    assert "Correlative search" in page
    assert page.count("not trained") >= 8
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["fusion"] == {"kept": 1}
    assert set(metrics["frame_error"]) == {"conditions", "methods", "comparisons"}
    assert metrics["frame_error"]["conditions"]["pairs"] == 5


def test_identity_is_off_by_what_was_drawn_and_the_search_by_less(shown, data):
    folder, _ = shown
    metrics = json.loads((folder / "metrics.json").read_text())["frame_error"]
    kept = json.loads((folder / "perturbations.json").read_text())["pairs"]
    table = read_pairs(synthetic_run(data).read("pack"), "test")
    drawn = []
    for i in range(len(table)):
        pair = table[i]
        if pair.pair_id in kept:
            perturbation = evaluation_perturbation(pair.pair_id, PerturbationRange(), seed=0)
            assert kept[pair.pair_id]["theta_c"]["x_m"] == perturbation.theta_c.x_m
            drawn.append(perturbed_pair(pair, perturbation).theta_w.as_array())
    assert len(drawn) == len(kept) == 5
    assert _mean(metrics, "identity") == pytest.approx(np.abs(drawn).mean(axis=0).tolist())
    assert _mean(metrics, "correlative")[0] < 0.5 * _mean(metrics, "identity")[0]
    assert metrics["comparisons"][0]["better"] == "correlative"


def test_what_was_recorded_is_shown_again_but_not_as_measured(shown, data, tmp_path):
    records = shown[0] / "records"
    assert sorted(path.name for path in records.iterdir()) == [
        "correlative-2m-45deg.json",
        "identity-2m-45deg.json",
    ]
    metrics, _ = _evaluate(data, tmp_path, "identity", count=2, records=records)
    sources = {name: row["source"] for name, row in metrics["methods"].items()}
    assert sources == {"identity": "measured", "correlative": "recorded"}
    assert metrics["methods"]["identity"]["conditions"]["pairs"] == 2
    assert metrics["methods"]["correlative"]["conditions"]["pairs"] == 5
    assert "recorded</span>" in (tmp_path / "index.html").read_text()


def test_rows_of_another_range_do_not_come_into_the_table(shown, data, tmp_path):
    metrics, _ = _evaluate(data, tmp_path, "identity", count=2, xy_range_m=1.0, records=shown[0] / "records")
    assert set(metrics["methods"]) == {"identity"}
    assert max(_mean(metrics, "identity")[:2]) < np.sqrt(2.0)


def test_rows_of_another_split_do_not_come_into_the_table_and_overwrite_nothing(shown, data, tmp_path):
    records = tmp_path / "records"
    metrics, _ = _evaluate(
        data, tmp_path, "identity", count=2, split="validation", records=records, record=True
    )
    assert metrics["conditions"]["split"] == "validation"
    assert [path.name for path in records.iterdir()] == ["identity-2m-45deg-validation.json"]
    (records / "correlative-2m-45deg.json").write_bytes(
        (shown[0] / "records" / "correlative-2m-45deg.json").read_bytes()
    )
    for split, there in (("validation", {"identity"}), ("test", {"identity", "correlative"})):
        metrics, _ = _evaluate(data, tmp_path, "identity", count=2, split=split, records=records)
        assert set(metrics["methods"]) == there
        assert metrics["methods"]["identity"]["conditions"]["split"] == split
    page = (tmp_path / "index.html").read_text()
    assert "5 pairs of test, not the 2 of test measured here" in page


def test_a_row_of_more_pairs_is_not_recorded_over(shown, data, tmp_path):
    records = shown[0] / "records"
    before = (records / "identity-2m-45deg.json").read_bytes()
    given = ["evaluate", "--data", str(data), "--methods", "identity", "--report", str(tmp_path / "r")]
    given += ["--workers", "1", "--records", str(records), "--record"]
    result = CliRunner().invoke(app, [*given, "--count", "4"])
    assert result.exit_code == 2
    assert result.stderr.startswith(f"rendezvous: {records}/identity-2m-45deg.json: recorded from 5 pairs, ")
    assert "replace by 4; measure as many, name another folder with --records, or delete" in result.stderr
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "r").exists()
    assert (records / "identity-2m-45deg.json").read_bytes() == before
    assert CliRunner().invoke(app, [*given, "--count", "5"]).exit_code == 0


def test_a_method_more_leaves_what_was_measured_before(data, tmp_path):
    before, told = _evaluate(data, tmp_path, "identity", count=3)
    assert "as measured before" not in told
    after, told = _evaluate(data, tmp_path, "identity", "orb", count=3)
    assert told.count("as measured before") == 1
    assert after["methods"]["identity"]["summary"] == before["methods"]["identity"]["summary"]
    for settings in ({"seed": 1}, {"yaw_range_deg": 30.0}, {"count": 2}):
        other, told = _evaluate(data, tmp_path, "identity", **{"count": 3, **settings})
        assert "as measured before" not in told
        assert _mean(other, "identity") != _mean(before, "identity")


CODE = Path(measured_pairs.__file__).parents[1]


@pytest.fixture(scope="module")
def trial(data) -> measured_pairs.Trial:
    pairs = read_pairs(synthetic_run(data).read("pack"), "test")
    return measured_pairs.Trial.of(pairs, [0], PerturbationRange(), seed=0)


def _methods(network: Path) -> list[Method]:
    """One without a network and one with."""
    return chosen_methods(("hough", "vit-lie"), {"vit-lie": network}, xy_range_m=2.0, yaw_range_rad=0.8)


@pytest.mark.parametrize(
    ("source", "without_network", "with_network"),
    [
        ("evaluation/estimates.py", True, True),
        ("stages/estimators.py", True, True),
        ("stages/measured_pairs.py", True, True),
        ("stages/trained_estimators.py", True, True),
        ("training/perturbation.py", True, True),
        ("alignment/window.py", True, True),
        ("baselines/hough.py", True, False),
        ("models/matcher.py", False, True),
        ("evaluation/report.py", False, False),
    ],
)
def test_outcomes_of_other_code_are_measured_anew(
    trial, network, tmp_path, monkeypatch, source, without_network, with_network
):
    shutil.copytree(CODE, tmp_path / "code", ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(measured_pairs, "_CODE", tmp_path / "code")
    methods = _methods(network)
    before = [measured_pairs.cache_key(method, trial, workers=1) for method in methods]
    with (tmp_path / "code" / source).open("a") as file:
        file.write("# changed\n")
    after = [measured_pairs.cache_key(method, trial, workers=1) for method in methods]
    assert [a != b for a, b in zip(after, before, strict=True)] == [without_network, with_network]


@pytest.mark.parametrize(
    ("package", "without_network"),
    [("numpy", True), ("scipy", True), ("opencv-python-headless", True), ("numba", True), ("torch", False)],
)
def test_outcomes_of_other_packages_or_workers_are_measured_anew(
    trial, network, monkeypatch, package, without_network
):
    methods, version = _methods(network), metadata.version
    before = [measured_pairs.cache_key(method, trial, workers=1) for method in methods]
    assert [measured_pairs.cache_key(method, trial, workers=1) for method in methods] == before
    more = [measured_pairs.cache_key(method, trial, workers=2) for method in methods]
    assert all(a != b for a, b in zip(more, before, strict=True))
    monkeypatch.setattr(metadata, "version", lambda name: "0" if name == package else version(name))
    after = [measured_pairs.cache_key(method, trial, workers=1) for method in methods]
    assert [a != b for a, b in zip(after, before, strict=True)] == [without_network, True]


def test_a_damaged_cache_is_measured_anew(data, tmp_path):
    before, _ = _evaluate(data, tmp_path, "identity", count=3)
    (kept,) = (tmp_path / "frame_error").iterdir()
    kept.write_text(kept.read_text()[:100])
    after, told = _evaluate(data, tmp_path, "identity", count=3)
    assert "as measured before" not in told
    assert _mean(after, "identity") == _mean(before, "identity")


@pytest.mark.slow
def test_workers_and_batches_change_nothing_but_time(data, tmp_path, monkeypatch):
    one, _ = _evaluate(data, tmp_path / "one", "hough", workers=1)
    monkeypatch.setattr(measured_pairs, "_PAIRS_PER_CALL", 2)
    two, _ = _evaluate(data, tmp_path / "two", "hough", workers=2)
    accuracy = [m["methods"]["hough"]["summary"]["by_overlap"] for m in (one, two)]
    assert accuracy[0] == accuracy[1]
    assert one["conditions"]["pairs"] > 2


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--methods", "identity,houg"), "method 'houg' is unknown; must be one of identity, hough, "),
        (("--split", "tset"), "--split is 'tset'; must be one of train, validation, test"),
        (("--data", "nowhere"), "nowhere/dataset: no manifest.json"),
        (("--weights", "matcher"), "--weights is 'matcher'; must be NAME=PATH"),
        (("--weights", "orb=x"), "orb has no weights"),
        (("--methods", "cnn-lie"), "cnn-lie: no weights in runs/cnn-lie/weights.safetensors or "),
        (("--xy-range-m", "9"), "xy_m is 9.0; must be from 0 to 8"),
    ],
)
def test_what_the_user_can_fix_is_one_line_and_exit_2(data, tmp_path, monkeypatch, options, said):
    monkeypatch.chdir(tmp_path)
    given = ["evaluate", "--data", str(data), "--methods", "identity", "--report", str(tmp_path)]
    result = CliRunner().invoke(app, [*given, *options])
    assert result.exit_code == 2
    assert said in result.stderr
    assert result.stderr.startswith("rendezvous: ")
    assert result.stderr.count("\n") == 1


def test_data_without_splits_is_told_before_anything_is_written(data, tmp_path):
    settings = Evaluation(dataset=f"{data}/explore", methods=("identity",), folder=tmp_path / "r")
    with pytest.raises(
        StoreError, match=r"no pairs in pairs/test-\*\.parquet, found 5 files without a split"
    ):
        evaluate(settings)
    assert not (tmp_path / "r").exists()


def test_a_damaged_recorded_row_is_told(data, tmp_path):
    (tmp_path / "orb-2m-45deg.json").write_text('{"format": 1}')
    given = ["evaluate", "--data", str(data), "--methods", "identity", "--report", str(tmp_path / "r")]
    given += ["--workers", "1"]
    result = CliRunner().invoke(app, [*given, "--records", str(tmp_path), "--count", "1"])
    assert result.exit_code == 2
    assert "orb-2m-45deg.json: no recorded row" in result.stderr
    assert not (tmp_path / "r").exists()


def test_a_missing_matplotlib_is_told_before_anything_is_measured(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    for name in ("evaluation.report_figures", "evaluation.report", "stages.evaluate"):
        monkeypatch.delitem(sys.modules, f"pipeline.{name}", raising=False)
    with pytest.raises(SetupError, match=r"need matplotlib, .*'rendezvous-fusion\[learn\]'"):
        __import__("pipeline.stages.evaluate")


@pytest.mark.slow
def test_no_network_no_torch(data, tmp_path):
    """In a process of its own: another test may have imported PyTorch."""
    import subprocess

    code = (
        "import sys; from pathlib import Path; from pipeline.stages.evaluate import Evaluation, evaluate\n"
        f"evaluate(Evaluation(dataset='{data}/dataset', methods=('identity',), count=1, "
        f"folder=Path('{tmp_path}'), records=Path('{tmp_path}/records')))\n"
        "print('torch' in sys.modules)"
    )
    main = tmp_path / "main.py"
    main.write_text("if __name__ == '__main__':\n" + "".join(f"    {line}\n" for line in code.splitlines()))
    ran = subprocess.run([sys.executable, str(main)], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "False"


def _trained(
    folder: Path, name: str, settings: dict, *, trained_on: tuple[str, ...] = (), **sampling
) -> Path:
    """Weights of a tiny network, and its curve, as `train` leaves them."""
    torch = pytest.importorskip("torch")
    from dataclasses import asdict

    from pipeline.training.checkpoint import weights_bytes
    from pipeline.training.loop import TrainingState
    from pipeline.training.parameters import Optimisation, Sampling
    from pipeline.training.registry import build_model

    torch.set_num_threads(1)
    model = build_model(name, settings, Sampling(**sampling), seed=0)
    data = {"folder": "somewhere", "pairs": {"train": 7}, "plans": {"train": 2}}
    about = {
        "model": name,
        "network": model.config(),
        "sampling": asdict(Sampling(**sampling)),
        "seed": 3,
        "data": {**data, "plan_digests": list(trained_on)},
    }
    state = TrainingState.fresh(model, Optimisation())
    state.samples = 16
    folder.mkdir(exist_ok=True)
    (folder / "weights.safetensors").write_bytes(weights_bytes(state, about))
    point = {"samples": 16, "elapsed_s": 30.0, "error_x_m": 1.0, "error_y_m": 1.0, "error_yaw_rad": 0.4}
    (folder / "curve.json").write_text(json.dumps({**about, "samples": 16, "curve": [point]}))
    return folder / "weights.safetensors"


TINY_VIT = {"cells": 48, "width": 32, "depth": 1, "heads": 2}


@pytest.fixture(scope="module")
def network(tmp_path_factory) -> Path:
    """Weights of a tiny transformer."""
    return _trained(tmp_path_factory.mktemp("vit-lie"), "vit-lie", TINY_VIT)


@pytest.mark.parametrize(
    ("name", "settings", "sampling"),
    [
        ("vit-lie", TINY_VIT, {"window_cells": 192}),
        ("vit-lie", TINY_VIT, {"window_cells": 192, "window_cell_m": 0.1}),
        ("matcher", {"channels": 8, "dilations": [1, 2]}, {"window_cell_m": 0.1}),
    ],
)
def test_a_network_trained_on_another_window_is_refused(data, tmp_path, name, settings, sampling):
    weights = _trained(tmp_path / "run", name, settings, **sampling)
    given = ["evaluate", "--data", str(data), "--methods", name, "--report", str(tmp_path / "r")]
    result = CliRunner().invoke(app, [*given, "--weights", f"{name}={weights}", "--workers", "1"])
    assert result.exit_code == 2
    cells, cell_m = sampling.get("window_cells", 384), sampling.get("window_cell_m", 0.05)
    assert f"trained on windows of {cells} cells of {cell_m} m; must be 384 of 0.05 m" in result.stderr
    assert not (tmp_path / "r").exists()


def test_a_trained_network_is_measured_with_its_history_and_its_attention(network, data, tmp_path):
    metrics, _ = _evaluate(data, tmp_path, "identity", "vit-lie", count=2, weights={"vit-lie": network})
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
    weights = _trained(
        tmp_path / "run", "vit-lie", TINY_VIT, trained_on=(plans[0][:12], plans[2][:12], "f" * 12)
    )
    given = {"weights": {"vit-lie": weights}, "records": tmp_path / "records"}
    metrics, told = _evaluate(data, tmp_path, "identity", "vit-lie", record=True, **given)
    assert told.count("trained on 2 of these") == 1
    assert f"warning: trained on 2 of these {len(plans)} floor plans" in told
    for _ in ("measured", "recorded"):
        rows = metrics["methods"]
        assert (rows["vit-lie"]["plans_trained_on"], rows["identity"]["plans_trained_on"]) == (2, None)
        assert f"trained on 2 of these {len(plans)} plans</span>" in (tmp_path / "index.html").read_text()
        metrics, _ = _evaluate(data, tmp_path, "identity", count=2, **given)
    assert metrics["methods"]["vit-lie"]["source"] == "recorded"


def test_the_curve_of_another_run_is_not_shown(network, data, tmp_path):
    weights, curve = tmp_path / "vit-lie.safetensors", tmp_path / "vit-lie.curve.json"
    weights.write_bytes(network.read_bytes())
    told = json.loads((network.parent / "curve.json").read_text())
    for seed, minutes in ((told["seed"], 0.5), (99, None)):
        curve.write_text(json.dumps({**told, "seed": seed}))
        metrics, _ = _evaluate(data, tmp_path / "r", "vit-lie", count=1, weights={"vit-lie": weights})
        assert metrics["methods"]["vit-lie"]["training"]["minutes"] == minutes
