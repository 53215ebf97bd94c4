from __future__ import annotations

import re

from rendezvous.evaluation.report.html_page import Cell, table


def test_headings_begin_where_the_words_below_them_do():
    header = [[("", 1), ("errors", 2), ("", 1)], [("method", 1), ("x", 1), ("y", 1), ("verdict", 1)]]
    line = [Cell(main="a", kind="name source"), Cell(main="1"), Cell(main="2"), Cell(main="b", kind="words")]
    markup = table(header, [[None], line]).text
    found = re.findall(r'<th colspan="(\d)"(?: class="(\w+)")?>(\w*)</th>', markup)
    assert found[:3] == [("1", "words", ""), ("2", "group", "errors"), ("1", "words", "")]
    assert found[3:] == [("1", "words", "method"), ("1", "", "x"), ("1", "", "y"), ("1", "words", "verdict")]


def test_a_table_may_have_no_lines():
    assert "<tbody></tbody>" in table([[("method", 1)]], []).text
