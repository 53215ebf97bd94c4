"""The part of the report on symmetric scenes."""

from __future__ import annotations

import numpy as np

from rendezvous.evaluation.frame_error.notes import SHARES
from rendezvous.evaluation.frame_error.symmetry import SYMMETRIC_SHARE, TOLERANCE_M, Symmetry
from rendezvous.evaluation.frame_error.table_one import title
from rendezvous.evaluation.frame_error.tables import accuracy_cells
from rendezvous.evaluation.report.html_page import Cell, Html, paragraph, table


def symmetry_section(symmetry: Symmetry | None) -> list[Html]:
    """Symmetric scenes apart from the others; nothing where frame errors are too small to confuse them."""
    if symmetry is None:
        return []
    return [
        paragraph(
            "Where a map looks much the same once it is turned, maps alone hardly tell one heading from "
            f"another. Map 1 is called symmetric if at least {100 * SYMMETRIC_SHARE:.0f} % of its walls come "
            f"to lie within {TOLERANCE_M:g} m of its walls by a turn of 90°, 180° or 270° about some point; "
            f"{symmetry.count} of {len(symmetry.share):,} pairs have such a map, and the median over all "
            f"pairs is {100 * float(np.median(symmetry.share)):.0f} %."
        ),
        _table(symmetry),
        paragraph(f"Mean position error, mean heading error, and success. {SHARES}", kind="note"),
    ]


def _table(symmetry: Symmetry) -> Html:
    counts = symmetry.count, len(symmetry.share) - symmetry.count
    groups = [
        (f"{word}, {count:,} pairs" if count else f"{word}, none", 3)
        for word, count in zip(("symmetric", "others"), counts, strict=True)
    ]
    header = [
        [("", 1), *groups],
        [("method", 1), *((word, 1) for _ in groups for word in ("position m", "heading °", "success"))],
    ]
    body: list[list[Cell | None]] = [
        [
            Cell(main=title(name), kind="name"),
            *accuracy_cells(apart.symmetric),
            *accuracy_cells(apart.others),
        ]
        for name, apart in symmetry.methods.items()
    ]
    return table(header, body)
