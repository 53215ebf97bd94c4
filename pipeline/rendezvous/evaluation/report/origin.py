"""The table at the end of a part of the report: what its figures were made from."""

from __future__ import annotations

from collections.abc import Sequence

from rendezvous.evaluation.report.html_page import Html, joined


def origin_table(told: Sequence[tuple[str, str]]) -> Html:
    """Names and values, line by line."""
    rows = "".join(
        joined(
            Html("<tr><td class='name'>"),
            name,
            Html("</td><td class='words'><code>"),
            value,
            Html("</code></td></tr>"),
        ).text
        for name, value in told
    )
    return Html(f'<div class="scroll"><table><tbody>{rows}</tbody></table></div>')
