"""The page in a real browser: at the width of a desk and of a phone, in light and in dark."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("seaborn")

import cv2
import seaborn as sns
from jinja2 import ChoiceLoader, DictLoader

from rendezvous.evaluation.report import page
from rendezvous.evaluation.report.charts import chart, svg
from rendezvous.evaluation.report.page import render_part, report_page

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed"),
]
DARK = "--blink-settings=preferredColorScheme=0"
TEMPLATE = """
{% extends "part.html.j2" %}
{% from "macros.html.j2" import section, table, cell, chart, image, origin with context %}
{% block lead %}<p class="lead">{{ "word" * 60 }} and more words</p>{% endblock %}
{% block sections %}
{% call section("table", "A wide table") %}
{% call table(columns) %}
<tr>{% for n in range(30) %}{{ cell(n | number(3), "0.123 … 0.234") }}{% endfor %}</tr>
{% endcall %}{% endcall %}
{% call section("figures", "Figures") %}
{{ chart(drawing, "words below", alt="a chart") }}
{% call image(pixels, "a picture") %}{{ "x" * 200 }}{% endcall %}
{{ origin([("digest", "0123456789abcdef" * 8)]) }}
{% endcall %}{% endblock %}
"""
# Told in the title, which --dump-dom prints: no script is part of the report itself.
MEASURE = """<script>addEventListener("load", () => {
const boxes = [...document.querySelectorAll(".scroll")], page = document.documentElement;
document.title = JSON.stringify({
  page: page.scrollWidth, window: innerWidth,
  wider: [...document.querySelectorAll("main *")].filter(
    e => !e.closest(".scroll") && e.getBoundingClientRect().right > innerWidth + 1).length,
  boxes: boxes.map(b => [b.clientWidth, b.scrollWidth, getComputedStyle(b).overflowX]),
  text: Math.min(...[...document.querySelectorAll("svg text")].map(t => t.getBoundingClientRect().height)),
  ink: getComputedStyle(document.querySelector("svg text")).fill,
})})</script>"""


@pytest.fixture(scope="module")
def html() -> str:
    with chart(3.0) as figure:
        left, right = figure.subplots(1, 2)
        sns.histplot(x=np.random.default_rng(0).normal(size=200), ax=left)
        right.plot([0, 1], [0, 1])
        drawing = svg(figure)
    environment = page._environment()
    loader = environment.loader
    environment.loader = ChoiceLoader([DictLoader({"fusion.html.j2": TEMPLATE}), loader])
    environment.cache.clear()
    made = render_part(
        "fusion",
        title="T" * 30,
        facts=[("f", "v")],
        columns=[f"column number {n}" for n in range(30)],
        drawing=drawing,
        pixels=np.zeros((400, 900, 3), np.uint8),
    )
    environment.loader = loader
    environment.cache.clear()
    return report_page([made])


def _chromium(folder: Path, html: str, *options: str, width_px: int) -> bytes:
    (folder / "page.html").write_text(html)
    quiet = ["--no-first-run", "--disable-background-networking", "--hide-scrollbars"]
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", *quiet]
    command += [f"--user-data-dir={folder / 'profile'}", f"--window-size={width_px},2400", *options]
    ran = subprocess.run([*command, f"file://{folder}/page.html"], capture_output=True, timeout=300)
    assert ran.returncode == 0, ran.stderr.decode(errors="replace")[-500:]
    return ran.stdout


def _phone(html: str, width_px: int) -> str:
    """The page in a frame of that width, because a window of Chromium is at least 500 pixels wide."""
    srcdoc = html.replace("&", "&amp;").replace('"', "&quot;")
    return (
        f'<body style="margin:0"><iframe srcdoc="{srcdoc}" style="border:0;width:{width_px}px;height:2400px">'
    )


@pytest.mark.parametrize("width_px", [1400, 390])
@pytest.mark.parametrize("dark", [False, True])
def test_nothing_is_cut_off_and_wide_tables_and_charts_scroll_in_their_boxes(html, tmp_path, width_px, dark):
    relay = '<script>addEventListener("load", () => { parent.document.title = document.title })</script>'
    framed = _phone(html.replace("</body>", MEASURE + relay + "</body>"), width_px)
    options = ["--dump-dom", *[DARK] * dark]
    dom = _chromium(tmp_path, framed, *options, width_px=1400).decode()
    found = json.loads(re.search(r"<title>(\{.*?\})</title>", dom)[1].replace("&quot;", '"'))
    assert found["window"] == width_px
    assert found["page"] <= width_px
    assert found["wider"] == 0
    assert len(found["boxes"]) == 3
    assert all(overflow == "auto" for *_, overflow in found["boxes"])
    inner, content, _ = found["boxes"][0]
    assert content > inner
    assert (found["boxes"][1][1] > found["boxes"][1][0]) == (width_px < 720)
    assert found["text"] >= 9.0
    red = int(re.search(r"\d+", found["ink"])[0])
    assert red > 128 if dark else red < 128


@pytest.mark.parametrize("dark", [False, True])
def test_the_page_is_dark_where_the_reader_wants_it_so(html, tmp_path, dark):
    shot = tmp_path / "shot.png"
    _chromium(tmp_path, html, f"--screenshot={shot}", *[DARK] * dark, width_px=1400)
    picture = cv2.imread(str(shot), cv2.IMREAD_GRAYSCALE)
    assert picture.shape == (2400, 1400)
    assert (np.median(picture) < 64) == dark
    ink = np.percentile(picture, 0.1 if not dark else 99.9)
    assert abs(float(ink) - float(np.median(picture))) > 120
