"""The figures that come with the project, as a later report reads them."""

from __future__ import annotations

import pytest

from pipeline.evaluation.fusion_summary import FusionFigures
from pipeline.evaluation.pose_summary import PoseSummary
from pipeline.evaluation.table_one import METHODS
from pipeline.stages.evaluate import RECORDS
from pipeline.stages.evaluate_fusion import FUSION_RECORDS
from pipeline.stages.evaluate_pose import POSE_RECORDS
from pipeline.stages.recorded_figures import FiguresFolder
from pipeline.stages.recorded_rows import RecordedRows


def test_rows_that_come_with_the_project_are_read_and_stand_under_their_names():
    rows = RecordedRows.read(RECORDS).rows
    assert {row.method for row in rows.values()} == set(METHODS)
    assert [row.conditions.file_name(row.method) for row in rows.values()] == list(rows)


@pytest.mark.parametrize(("folder", "kind"), [(POSE_RECORDS, PoseSummary), (FUSION_RECORDS, FusionFigures)])
def test_figures_that_come_with_the_project_are_read_and_stand_under_their_names(folder, kind):
    rows = FiguresFolder.read(folder, kind, command="evaluate").rows
    assert rows
    assert [row.file_name for row in rows.values()] == list(rows)
