from __future__ import annotations

import io
import json
from types import SimpleNamespace

import pytest
from markupsafe import Markup
from rich.console import Console

from rendezvous.commands.evaluate.frame_error import RECORDS
from rendezvous.commands.evaluate.fusion import FUSION_RECORDS
from rendezvous.commands.evaluate.kept import RecordFolder, keep_evaluation, kept_metrics
from rendezvous.commands.evaluate.relative_pose import POSE_RECORDS
from rendezvous.errors import ConfigError, StoreError
from rendezvous.evaluation.frame_error.measured_row import MeasuredRow
from rendezvous.evaluation.fusion.summary import FusionFigures
from rendezvous.evaluation.relative_pose.summary import PoseSummary
from rendezvous.evaluation.report.page import ReportPart
from rendezvous.evaluation.report.recorded_figures import RecordedFigures
from rendezvous.methods import METHODS
from rendezvous.store.disk import Disk


def _keep(folder, key: str, words: str) -> str:
    """Keep an evaluation that tells some words; returns what the user was told."""
    part = ReportPart(key=key, title=key, html=Markup(f"<p>{words}</p>"))
    told = io.StringIO()
    keep_evaluation(Disk(str(folder)), part, {"words": words}, Console(file=told))
    return told.getvalue()


def test_an_evaluation_replaces_its_own_figures_and_its_own_part(tmp_path):
    _keep(tmp_path, "frame_error", "old errors")
    _keep(tmp_path, "fusion", "fused maps")
    assert _keep(tmp_path, "frame_error", "new errors") == ""
    assert json.loads((tmp_path / "metrics.json").read_text()) == {
        "frame_error": {"words": "new errors"},
        "fusion": {"words": "fused maps"},
    }
    page = (tmp_path / "index.html").read_text()
    assert "old errors" not in page
    assert 0 < page.index("new errors") < page.index("fused maps")


@pytest.mark.parametrize("damage", ["", '{"format": 1, "ti', '{"format": 99}', None])
def test_a_part_of_another_evaluation_that_cannot_be_shown_is_told_and_left_out(tmp_path, damage):
    _keep(tmp_path, "frame_error", "errors")
    name = tmp_path / "parts" / "frame_error.json"
    name.unlink() if damage is None else name.write_text(damage)
    told = _keep(tmp_path, "fusion", "fused maps")
    assert told.startswith(f"report: warning: {name}: ")
    assert told.endswith("; the page is without it until that evaluation is run again\n")
    assert told.count("\n") == 1
    page = (tmp_path / "index.html").read_text()
    assert "fused maps" in page
    assert "The evaluation “frame_error” was made" in page
    assert _keep(tmp_path, "frame_error", "errors") == ""
    assert "was made" not in (tmp_path / "index.html").read_text()


def test_a_part_is_shown_though_the_figures_were_deleted(tmp_path):
    _keep(tmp_path, "frame_error", "errors")
    (tmp_path / "metrics.json").unlink()
    _keep(tmp_path, "fusion", "fused maps")
    assert "errors" in (tmp_path / "index.html").read_text()


def test_damaged_figures_are_told_and_nothing_is_replaced(tmp_path):
    _keep(tmp_path, "frame_error", "errors")
    (tmp_path / "metrics.json").write_text('{"frame_error"')
    before = (tmp_path / "index.html").read_bytes()
    with pytest.raises(
        StoreError, match=r"metrics\.json: damaged \(.*\); run the stage again once that file"
    ):
        _keep(tmp_path, "fusion", "fused maps")
    assert (tmp_path / "index.html").read_bytes() == before
    assert kept_metrics(Disk(str(tmp_path / "nowhere"))) == {}


@pytest.mark.parametrize(
    ("folder", "kind"),
    [
        (RECORDS, MeasuredRow),
        (POSE_RECORDS, RecordedFigures[PoseSummary]),
        (FUSION_RECORDS, RecordedFigures[FusionFigures]),
    ],
)
def test_figures_that_come_with_the_project_are_read_and_stand_under_their_names(folder, kind):
    found = RecordFolder.read(folder, kind, command="evaluate")
    assert found.rows
    assert [row.conditions.file_name(row.name) for row in found.rows.values()] == list(found.rows)
    for name, row in found.rows.items():
        kept = json.loads(found.disk.read(name))
        assert json.loads(json.dumps(row.to_json())) == kept | row.to_json()


def test_every_method_has_a_recorded_row():
    rows = RecordFolder.read(RECORDS, MeasuredRow, command="evaluate").rows
    assert {row.method for row in rows.values()} == set(METHODS)


class _Conditions:
    """Of a row that was measured on so many pairs."""

    def __init__(self, count: int, split: str = "test") -> None:
        self.measured_on, self.split = (count, "pairs"), split

    def file_name(self, name: str) -> str:
        return f"{name}.json"


def test_only_a_row_that_was_measured_on_more_is_not_recorded_over(tmp_path):
    row = SimpleNamespace(name="orb", conditions=_Conditions(100))
    other = SimpleNamespace(name="matcher", conditions=_Conditions(100, "validation"))
    folder = RecordFolder(disk=Disk(str(tmp_path)), rows={"orb.json": row, "matcher.json": other})
    folder.require_no_loss(["orb"], _Conditions(100))
    folder.require_no_loss(["hough"], _Conditions(1))
    with pytest.raises(ConfigError, match=r"orb\.json: recorded from 100 pairs, .* replace by 99; measure"):
        folder.require_no_loss(["hough", "orb"], _Conditions(99))
    assert folder.of_split("test") == {"orb": row}


def test_folders_below_are_of_other_evaluations(tmp_path):
    for name in ("a.json", "below/b.json", "c.txt"):
        Disk(str(tmp_path)).write(name, b"no row")
    with pytest.raises(StoreError, match=r"a\.json"):
        RecordFolder.read(tmp_path, MeasuredRow, command="evaluate")
    (tmp_path / "a.json").unlink()
    assert RecordFolder.read(tmp_path, MeasuredRow, command="evaluate").rows == {}
    assert RecordFolder.read(tmp_path / "nowhere", MeasuredRow, command="evaluate").rows == {}
