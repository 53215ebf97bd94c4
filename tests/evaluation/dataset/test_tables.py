from __future__ import annotations

from rendezvous.evaluation.dataset.sampling import evenly_by
from rendezvous.evaluation.dataset.tables import column_table, markdown_table
from rendezvous.schema import PAIRS


def test_numbers_are_aligned_to_the_right_and_bars_escaped():
    assert markdown_table(("a|b", "n"), [("x|y", 1), ("z", "2,000.5%")]).splitlines() == [
        "| a|b | n |",
        "| --- | ---: |",
        "| x\\|y | 1 |",
        "| z | 2,000.5% |",
    ]


def test_the_data_dictionary_names_shapes():
    lines = column_table(PAIRS).splitlines()
    assert any(line.startswith("| `K` | 9 doubles | px |") for line in lines)
    assert any(line.startswith("| `projected_cuboid_px` | 9×2 doubles | px |") for line in lines)
    assert len(lines) == len(PAIRS.columns) + 2


def test_even_ranks_go_from_low_to_high():
    values = [0.5, 0.1, 0.9, 0.3, 0.7, 0.2]
    assert [values[i] for i in evenly_by(values, 3)] == [0.2, 0.5, 0.9]
    assert [values[i] for i in evenly_by(values, 10)] == sorted(values)
