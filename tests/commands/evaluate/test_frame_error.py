from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

pytest.importorskip("matplotlib")

import rendezvous
from rendezvous.alignment.estimate import Estimate
from rendezvous.alignment.window import MapWindow, SearchRange
from rendezvous.cli.__main__ import app
from rendezvous.commands.evaluate import measuring
from rendezvous.commands.evaluate.frame_error import Evaluation, evaluate
from rendezvous.errors import SetupError, StoreError
from rendezvous.evaluation.frame_error.symmetry import turn_symmetry
from rendezvous.geometry.se2 import SE2
from rendezvous.training.frame_error.pairs import (
    PerturbationRange,
    evaluation_perturbation,
    perturbed_pair,
    read_pairs,
)
from tests.commands.evaluate.toy_evaluation import evaluated, mean_error, toy_dataset
from tests.synthetic_dataset import synthetic_run


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    return toy_dataset(tmp_path_factory.mktemp("data"))


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
    assert "The evaluation “fusion” was made" in page
    assert "parts/fusion.json: missing; the page is without it" in result.stderr
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["fusion"] == {"kept": 1}
    assert set(metrics["frame_error"]) == {"conditions", "methods", "symmetry", "comparisons"}
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
            drawn.append(perturbed_pair(pair, perturbation).theta_v.as_array())
    assert len(drawn) == len(kept) == 5
    assert mean_error(metrics, "identity") == pytest.approx(np.abs(drawn).mean(axis=0).tolist())
    assert mean_error(metrics, "correlative")[0] < 0.5 * mean_error(metrics, "identity")[0]
    assert metrics["comparisons"][0]["better"] == "correlative"


def test_what_was_recorded_is_shown_again_but_not_as_measured(shown, data, tmp_path):
    records = shown[0] / "records"
    assert sorted(path.name for path in records.iterdir()) == [
        "correlative-2m-45deg.json",
        "identity-2m-45deg.json",
    ]
    metrics, _ = evaluated(data, tmp_path, "identity", count=2, records=records)
    sources = {name: row["source"] for name, row in metrics["methods"].items()}
    assert sources == {"identity": "measured", "correlative": "recorded"}
    assert metrics["methods"]["identity"]["conditions"]["pairs"] == 2
    assert metrics["methods"]["correlative"]["conditions"]["pairs"] == 5
    assert "recorded</span>" in (tmp_path / "index.html").read_text()


def test_rows_of_another_range_do_not_come_into_the_table(shown, data, tmp_path):
    metrics, _ = evaluated(data, tmp_path, "identity", count=2, xy_range_m=1.0, records=shown[0] / "records")
    assert set(metrics["methods"]) == {"identity"}
    assert max(mean_error(metrics, "identity")[:2]) < np.sqrt(2.0)


def test_rows_of_another_split_do_not_come_into_the_table_and_overwrite_nothing(shown, data, tmp_path):
    records = tmp_path / "records"
    metrics, _ = evaluated(
        data, tmp_path, "identity", count=2, split="validation", records=records, record=True
    )
    assert metrics["conditions"]["split"] == "validation"
    assert [path.name for path in records.iterdir()] == ["identity-2m-45deg-validation.json"]
    (records / "correlative-2m-45deg.json").write_bytes(
        (shown[0] / "records" / "correlative-2m-45deg.json").read_bytes()
    )
    for split, there in (("validation", {"identity"}), ("test", {"identity", "correlative"})):
        metrics, _ = evaluated(data, tmp_path, "identity", count=2, split=split, records=records)
        assert set(metrics["methods"]) == there
        assert metrics["methods"]["identity"]["conditions"]["split"] == split
    page = (tmp_path / "index.html").read_text()
    assert "5 pairs of test, not the 2 of test measured here" in page


def test_symmetric_scenes_stand_apart_where_any_heading_is_asked_for(data, tmp_path):
    for yaw_range_deg, there in ((45.0, False), (180.0, True)):
        metrics, _ = evaluated(data, tmp_path, "identity", count=2, yaw_range_deg=yaw_range_deg)
        assert ("Symmetric scenes apart" in (tmp_path / "index.html").read_text()) == there
    table = read_pairs(synthetic_run(data).read("pack"), "test")
    drawn = json.loads((tmp_path / "perturbations.json").read_text())["pairs"]
    maps = [table[i].grid_1 for i in range(len(table)) if table[i].pair_id in drawn]
    symmetric = sum(turn_symmetry(grid) >= metrics["symmetry"]["symmetric_share"] for grid in maps)
    assert metrics["symmetry"]["symmetric_pairs"] == symmetric
    told = metrics["symmetry"]["methods"]["identity"]
    assert sum(part["count"] for part in told.values() if part is not None) == 2


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
    before, told = evaluated(data, tmp_path, "identity", count=3)
    assert "as measured before" not in told
    after, told = evaluated(data, tmp_path, "identity", "orb", count=3)
    assert told.count("as measured before") == 1
    assert after["methods"]["identity"]["summary"] == before["methods"]["identity"]["summary"]
    for settings in ({"seed": 1}, {"yaw_range_deg": 30.0}, {"count": 2}):
        other, told = evaluated(data, tmp_path, "identity", **{"count": 3, **settings})
        assert "as measured before" not in told
        assert mean_error(other, "identity") != mean_error(before, "identity")


def test_a_damaged_cache_is_measured_anew(data, tmp_path):
    before, _ = evaluated(data, tmp_path, "identity", count=3)
    (kept,) = (tmp_path / "frame_error").iterdir()
    kept.write_text(kept.read_text()[:100])
    after, told = evaluated(data, tmp_path, "identity", count=3)
    assert "as measured before" not in told
    assert mean_error(after, "identity") == mean_error(before, "identity")


@pytest.mark.slow
def test_workers_and_batches_change_nothing_but_time(data, tmp_path, monkeypatch):
    one, _ = evaluated(data, tmp_path / "one", "hough", workers=1)
    monkeypatch.setattr(measuring, "_ITEMS_PER_CALL", 2)
    two, _ = evaluated(data, tmp_path / "two", "hough", workers=2)
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
        (("--xy-range-m", "9"), "--xy-range-m is 9; must be from 0 to 8"),
        (("--yaw-range-deg", "181"), "--yaw-range-deg is 181; must be from 0 to 180"),
        (("--yaw-range-deg", "nan"), "--yaw-range-deg is nan; must be from 0 to 180"),
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
    assert "orb-2m-45deg.json: no recorded figures" in result.stderr
    assert not (tmp_path / "r").exists()


def test_damaged_figures_are_told_before_anything_is_measured(data, tmp_path):
    (tmp_path / "metrics.json").write_text("{")
    with pytest.raises(StoreError, match=r"metrics\.json: damaged"):
        evaluated(data, tmp_path, "identity", count=1)
    assert [path.name for path in tmp_path.iterdir()] == ["metrics.json"]


def test_a_missing_matplotlib_is_told_before_anything_is_measured(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    for name in (
        "evaluation.report.charts",
        "evaluation.frame_error.charts",
        "evaluation.frame_error.report",
        "commands.evaluate.frame_error",
    ):
        monkeypatch.delitem(sys.modules, f"rendezvous.{name}", raising=False)
    with pytest.raises(SetupError, match=r"needs matplotlib, .*'rendezvous-fusion\[learn\]'"):
        __import__("rendezvous.commands.evaluate.frame_error")


@pytest.mark.slow
def test_no_network_no_torch(data, tmp_path):
    """In a process of its own: another test may have imported PyTorch."""
    import subprocess

    code = (
        "import sys; from pathlib import Path\n"
        "from rendezvous.commands.evaluate.frame_error import Evaluation, evaluate\n"
        f"evaluate(Evaluation(dataset='{data}/dataset', methods=('identity',), count=1, "
        f"folder=Path('{tmp_path}'), records=Path('{tmp_path}/records')))\n"
        "print('torch' in sys.modules)"
    )
    main = tmp_path / "main.py"
    main.write_text("if __name__ == '__main__':\n" + "".join(f"    {line}\n" for line in code.splitlines()))
    ran = subprocess.run([sys.executable, str(main)], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "False"


class HalfCorrecting:
    """Knows nothing of the maps, and keeps the range it was given."""

    name = "a user's own"
    ranges: list[SearchRange] = []  # noqa: RUF012 - the tests read it

    def __init__(self, *, search: SearchRange) -> None:
        self.ranges.append(search)

    def __call__(self, window: MapWindow) -> Estimate:
        return Estimate(theta=SE2(0.1, 0.0, 0.0))


def test_a_users_method_is_measured_beside_the_shipped_ones_from_python(data, tmp_path):
    table = rendezvous.evaluate(
        data,
        methods={"mine": HalfCorrecting},
        beside=["identity"],
        count=3,
        xy_range_m=1.0,
        report=tmp_path / "report",
    )
    assert list(table["method"]) == ["identity"] * 3 + ["mine"] * 3
    assert HalfCorrecting.ranges[-1] == SearchRange.covering(xy_m=1.0, yaw_rad=math.pi / 4)
    metrics = json.loads((tmp_path / "report" / "metrics.json").read_text())["frame_error"]
    means = table[["x_m", "y_m", "yaw_rad"]].abs().groupby(table["method"]).mean()
    for name in ("identity", "mine"):
        assert mean_error(metrics, name) == pytest.approx(means.loc[name].tolist())
    page = (tmp_path / "report" / "index.html").read_text()
    assert ">mine <span" in page


def test_a_users_method_is_measured_by_its_place_on_the_command_line(data, tmp_path):
    given = ["evaluate", "--data", str(data), "--methods", f"orb,{__name__}:HalfCorrecting", "--count", "2"]
    result = CliRunner().invoke(app, [*given, "--report", str(tmp_path), "--workers", "1"])
    assert result.exit_code == 0, result.stderr
    metrics = json.loads((tmp_path / "metrics.json").read_text())["frame_error"]
    measured = [name for name, row in metrics["methods"].items() if row["source"] == "measured"]
    assert measured == ["orb", "HalfCorrecting"]
