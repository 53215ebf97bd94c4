from __future__ import annotations

import numpy as np
import pytest

from rendezvous.errors import PipelineError
from rendezvous.interop.pose_label import label_of
from rendezvous.schema import PAIRS, POSES
from tests.stages.published_images import ABSENT, CAMERA, HIDDEN, pair_row, pose_row


@pytest.mark.parametrize(("schema", "made"), [(POSES, pose_row), (PAIRS, pair_row)])
def test_a_rows_label_projects_and_counts_as_its_columns_say(schema, made):
    rows = [made(i) for i in range(10)]
    labels = [label_of(row) for row in schema.rows(schema.table(rows))]
    for i, (row, label) in enumerate(zip(rows, labels, strict=True)):
        assert label.camera == CAMERA
        assert label.visibility == pytest.approx(row["visibility"])
        if i == ABSENT:
            assert label.T_c_o is None
            assert label.box_px is None
            continue
        assert np.array_equal(label.T_c_o, row["T_c_o"])
        assert label.projected_cuboid_px() == pytest.approx(row["projected_cuboid_px"])
        assert label.box_px == (None if i == HIDDEN else (9.5, 19.5, 29.5, 22.5))


def test_a_row_that_contradicts_itself_is_told():
    (row,) = POSES.rows(POSES.table([pose_row(0, visible_px=713, silhouette_px=712, visibility=713 / 712)]))
    with pytest.raises(PipelineError, match="713 visible of 712 pixels"):
        label_of(row)
