"""The figures that come with the project, as a later report reads them."""

from __future__ import annotations

import pytest
from rendezvous.commands.evaluate.frame_error import RECORDS
from rendezvous.commands.evaluate.fusion import FUSION_RECORDS
from rendezvous.commands.evaluate.recorded_figures import FiguresFolder
from rendezvous.commands.evaluate.recorded_rows import RecordedRows
from rendezvous.commands.evaluate.relative_pose import POSE_RECORDS
from rendezvous.evaluation.frame_error.table_one import METHODS
from rendezvous.evaluation.fusion.summary import FusionFigures
from rendezvous.evaluation.relative_pose.summary import PoseSummary


def test_rows_that_come_with_the_project_are_read_and_stand_under_their_names():
    rows = RecordedRows.read(RECORDS).rows
    assert {row.method for row in rows.values()} == set(METHODS)
    assert [row.conditions.file_name(row.method) for row in rows.values()] == list(rows)


@pytest.mark.parametrize(("folder", "kind"), [(POSE_RECORDS, PoseSummary), (FUSION_RECORDS, FusionFigures)])
def test_figures_that_come_with_the_project_are_read_and_stand_under_their_names(folder, kind):
    rows = FiguresFolder.read(folder, kind, command="evaluate").rows
    assert rows
    assert [row.file_name for row in rows.values()] == list(rows)
