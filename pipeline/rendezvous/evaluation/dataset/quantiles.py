"""Quantiles of what was measured, as a table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rendezvous.evaluation.dataset.tables import markdown_table
from rendezvous.geometry.se2 import Array

_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def quantile_table(measures: Sequence[tuple[str, Array, int]]) -> str:
    """One line per measure: what it is called, its values (N,), and how many decimals to show.

    A measure without values has empty cells.
    """
    rows = []
    for title, values, decimals in measures:
        quantiles = np.quantile(values, _QUANTILES) if len(values) else ()
        shown = [f"{value:.{decimals}f}" for value in quantiles] or [""] * len(_QUANTILES)
        rows.append((title, *shown))
    return markdown_table(("", *(f"{q:.0%}" for q in _QUANTILES)), rows)
