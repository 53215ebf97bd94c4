"""The figures that come with the project, as a later report reads them."""

from __future__ import annotations

import json

import pytest

from rendezvous.commands.evaluate.frame_error import RECORDS
from rendezvous.commands.evaluate.fusion import FUSION_RECORDS
from rendezvous.commands.evaluate.recorded import RecordFolder
from rendezvous.commands.evaluate.relative_pose import POSE_RECORDS
from rendezvous.evaluation.frame_error.measured_row import MeasuredRow
from rendezvous.evaluation.fusion.summary import FusionFigures
from rendezvous.evaluation.relative_pose.summary import PoseSummary
from rendezvous.evaluation.report.recorded_figures import RecordedFigures
from rendezvous.methods import METHODS


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
