"""Rewrite the generated parts of the documentation: `python -m rendezvous.documentation`.

A generated part stands between `<!-- generated: NAME -->` and `<!-- end of NAME -->` and says what the code
says; a test compares the two.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable
from pathlib import Path

import yaml

from rendezvous.config.stage_table import STAGES, Stage
from rendezvous.evaluation.dataset.tables import column_table, markdown_table
from rendezvous.resources import ROOT
from rendezvous.schema import PAIRS, POSES

_PACKAGE = ROOT / "pipeline" / "rendezvous"


def documented(text: str) -> str:
    """The text of a page with its generated parts as they should be."""
    for name in re.findall(r"<!-- generated: (\w+) -->", text):
        head, tail = f"<!-- generated: {name} -->", f"<!-- end of {name} -->"
        before, rest = text.split(head)
        text = f"{before}{head}\n\n{_PARTS[name]()}\n\n{tail}{rest.split(tail)[1]}"
    return text


def pages() -> list[Path]:
    """Every page that has generated parts."""
    found = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    return [page for page in found if "<!-- generated: " in page.read_text(encoding="utf-8")]


def _stages() -> str:
    """The stages in flow order: what each reads, writes and does."""
    links = yaml.safe_load((ROOT / "stages.yaml").read_text(encoding="utf-8"))["stages"]
    rows = [
        (
            f"[`{stage.name}`](pipeline/rendezvous/stages/{stage.name}.py)",
            ", ".join(f"`data/{links[read]['writes']}/`" for read in stage.reads),
            f"`{_above(stage)}{links[stage.name]['writes']}/`",
            stage.about,
        )
        for stage in STAGES.values()
    ]
    return markdown_table(("stage", "reads", "writes", "what it does"), rows)


def _above(stage: Stage) -> str:
    """The folder in which a stage's own lies."""
    if stage.apart:
        return "data/replayed/"
    return "" if stage.beside_data else "data/"


def _rooms() -> str:
    """Every package of the code, with its docstring."""
    inits = [init for init in sorted(_PACKAGE.rglob("__init__.py")) if init.parent != _PACKAGE]
    rows = [(f"`{init.parent.relative_to(_PACKAGE)}/`", _first_sentence(init)) for init in inits]
    return markdown_table(("folder of `pipeline/rendezvous/`", "what it holds"), rows)


def _first_sentence(module: Path) -> str:
    return (ast.get_docstring(ast.parse(module.read_text(encoding="utf-8"))) or "").splitlines()[0]


_PARTS: dict[str, Callable[[], str]] = {
    "stages": _stages,
    "rooms": _rooms,
    "columns": lambda: column_table(PAIRS),
    "poses": lambda: column_table(POSES),
}

if __name__ == "__main__":
    for page in pages():
        page.write_text(documented(page.read_text(encoding="utf-8")), encoding="utf-8")
