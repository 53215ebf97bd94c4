"""Tables in Markdown."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rendezvous.geometry.se2 import Array
from rendezvous.schema import (
    IMAGE_TYPE,
    SE2_TYPE,
    SE3_TYPE,
    SIZE_TYPE,
    SOLIDS_TYPE,
    TRAJECTORY_TYPE,
    Column,
    TableSchema,
)
from rendezvous.splits import SPLITS

_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
_TYPE_NAMES: dict[pa.DataType, str] = {
    IMAGE_TYPE: "image",
    SE2_TYPE: "SE(2), 3 doubles",
    SE3_TYPE: "SE(3), 16 doubles",
    SIZE_TYPE: "struct of x_m, y_m, z_m",
    TRAJECTORY_TYPE: "list of (t_s, x_m, y_m, yaw_rad)",
    SOLIDS_TYPE: "list of solids",
}


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A Markdown table. Columns that hold only numbers below the header are aligned to the right."""
    cells = [[str(cell).replace("|", "\\|") for cell in row] for row in rows]
    numeric = [bool(cells) and all(_is_number(row[i]) for row in cells) for i in range(len(header))]
    rule = ["---:" if right else "---" for right in numeric]
    return "\n".join("| " + " | ".join(row) + " |" for row in [list(header), rule, *cells])


def quantile_table(measures: Sequence[tuple[str, Array, int]]) -> str:
    """Quantiles of each measure, one per line; the cells of a measure without values are empty.

    Args:
        measures: title, values (N,) and number of decimals of each.
    """
    rows = []
    for title, values, decimals in measures:
        quantiles = np.quantile(values, _QUANTILES) if len(values) else ()
        rows.append((title, *([f"{value:.{decimals}f}" for value in quantiles] or [""] * len(_QUANTILES))))
    return markdown_table(("", *(f"{q:.0%}" for q in _QUANTILES)), rows)


def split_table(rows: pa.Table, counts: Mapping[str, Callable[[pa.Table], int]]) -> str:
    """Counts of each split that has rows, one split per line, and their totals.

    Args:
        rows: a table with a column `split`.
        counts: what to count in a split's rows, by the column's title.
    """
    parts = {split: rows.filter(pc.field("split") == split) for split in SPLITS}
    lines = {split: [count(part) for count in counts.values()] for split, part in parts.items() if len(part)}
    lines["all"] = [sum(column) for column in zip(*lines.values(), strict=True)]
    return markdown_table(("split", *counts), [(split, *line) for split, line in lines.items()])


def distinct(column: str) -> Callable[[pa.Table], int]:
    """Counts a column's distinct values."""
    return lambda rows: len(rows[column].unique())


def column_table(schema: TableSchema) -> str:
    """The data dictionary of a table."""
    return markdown_table(
        ("column", "type", "unit", "meaning"),
        [(f"`{column.name}`", _type_name(column), column.unit, column.about) for column in schema.columns],
    )


def _type_name(column: Column) -> str:
    if column.type in _TYPE_NAMES:
        return _TYPE_NAMES[column.type]
    sizes, inner = [], column.type
    while pa.types.is_fixed_size_list(inner):
        sizes.append(str(inner.list_size))
        inner = inner.value_type
    return f"{'×'.join(sizes)} doubles" if sizes else str(inner)


def _is_number(cell: str) -> bool:
    return cell.replace(",", "").replace(".", "").strip("-%").isdigit()
