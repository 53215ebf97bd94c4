from __future__ import annotations

import numpy as np
import pyarrow as pa

from rendezvous.evaluation.dataset.card import quality_table
from rendezvous.evaluation.dataset.sampling import evenly_by
from rendezvous.evaluation.dataset.tables import (
    column_table,
    distinct,
    markdown_table,
    quantile_table,
    split_table,
)
from rendezvous.schema import EXPLORE, PAIRS
from tests.synthetic import synthetic_row


def test_numbers_are_aligned_to_the_right_and_bars_escaped():
    assert markdown_table(("a|b", "n"), [("x|y", 1), ("z", "2,000.5%")]).splitlines() == [
        "| a|b | n |",
        "| --- | ---: |",
        "| x\\|y | 1 |",
        "| z | 2,000.5% |",
    ]


def test_the_data_dictionary_names_shapes():
    lines = column_table(PAIRS).splitlines()
    for name, shape in (("K", "9"), ("projected_cuboid_px", "9×2")):
        assert any(line.startswith(f"| `{name}` | {shape} doubles | px |") for line in lines)
    assert len(lines) == len(PAIRS.columns) + 2


def test_quantiles_stand_from_low_to_high():
    values = np.linspace(0.0, 10.0, 101)
    assert quantile_table([("Range [m]", values, 1), ("none", np.zeros(0), 1)]).splitlines() == [
        "|  | 5% | 25% | 50% | 75% | 95% |",
        "| --- | --- | --- | --- | --- | --- |",
        "| Range [m] | 0.5 | 2.5 | 5.0 | 7.5 | 9.5 |",
        "| none |  |  |  |  |  |",
    ]


def test_splits_that_have_rows_are_counted_and_added_up():
    rows = pa.table({"split": ["test", "train", "train"], "plan": ["b", "a", "a"]})
    assert split_table(rows, {"plans": distinct("plan"), "pairs": len}).splitlines()[2:] == [
        "| train | 1 | 2 |",
        "| test | 1 | 1 |",
        "| all | 2 | 3 |",
    ]


def test_the_card_pools_both_robots_and_leaves_out_what_was_not_measured():
    first, second = (synthetic_row(np.random.default_rng(plan), plan=plan) for plan in range(2))
    errors = [(first, 0.1, 0.3), (second, 0.1, 0.3), (first | {"wall_agreement": None}, 0.2, 0.2)]
    pairs = EXPLORE.table(
        [
            row | {"slam_heading_error_0_rad": error_0, "slam_heading_error_1_rad": error_1}
            for row, error_0, error_1 in errors
        ]
    )
    lines = {line.split(" | ")[0]: line for line in quality_table(pairs).splitlines()}
    assert lines["| SLAM heading error [°]"].split(" | ")[1:4] == ["5.73", "7.16", "11.46"]
    share = 50.0 * (first["wall_agreement"] + second["wall_agreement"])
    assert lines["| Walls that agree, by `T_m0_m1` [%]"].split(" | ")[3] == f"{share:.1f}"


def test_even_ranks_go_from_low_to_high():
    values = [0.5, 0.1, 0.9, 0.3, 0.7, 0.2]
    assert [values[i] for i in evenly_by(values, 3)] == [0.2, 0.5, 0.9]
    assert [values[i] for i in evenly_by(values, 10)] == sorted(values)
