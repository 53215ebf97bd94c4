"""Tables in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pyarrow as pa

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

_TYPE_NAMES: dict[pa.DataType, str] = {
    IMAGE_TYPE: "image",
    SE2_TYPE: "SE(2), 3 doubles",
    SE3_TYPE: "SE(3), 16 doubles",
    SIZE_TYPE: "struct of x_m, y_m, z_m",
    TRAJECTORY_TYPE: "list of (t_s, x_m, y_m, yaw_rad)",
    SOLIDS_TYPE: "list of solids",
}


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A table; columns that hold only numbers below the header are aligned to the right."""
    cells = [[str(cell).replace("|", "\\|") for cell in row] for row in rows]
    numeric = [bool(cells) and all(_is_number(row[i]) for row in cells) for i in range(len(header))]
    rule = ["---:" if right else "---" for right in numeric]
    return "\n".join("| " + " | ".join(row) + " |" for row in [list(header), rule, *cells])


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
