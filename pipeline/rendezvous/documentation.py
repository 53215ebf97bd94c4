"""Rewrite the generated parts of the README: `python -m rendezvous.documentation`.

They stand between `<!-- generated: NAME -->` and `<!-- end of NAME -->` and say what the code says, so
that the two cannot drift apart; a test compares them.
"""

from __future__ import annotations

import ast
from pathlib import Path

import yaml

from rendezvous.evaluation.dataset.tables import column_table, markdown_table
from rendezvous.resources import ROOT
from rendezvous.schema import PAIRS, POSES

_BESIDE_THE_DATA = ("train", "train_pose")
"""Stages that write to the working folder, as what they make outlives the data."""


def documented(readme: str, *, root: Path = ROOT) -> str:
    """The README with its generated parts as they should be."""
    tables = {
        "stages": _stage_table(root),
        "columns": column_table(PAIRS),
        "poses": column_table(POSES),
    }
    for name, text in tables.items():
        head, tail = f"<!-- generated: {name} -->", f"<!-- end of {name} -->"
        before, rest = readme.split(head)
        readme = f"{before}{head}\n\n{text}\n\n{tail}{rest.split(tail)[1]}"
    return readme


def _stage_table(root: Path) -> str:
    """The stages of `stages.yaml`, each with the first sentence of its module."""
    stages = yaml.safe_load((root / "stages.yaml").read_text())["stages"]
    rows = [
        (
            f"[`{name}`](pipeline/rendezvous/stages/{name}.py)",
            ", ".join(f"`data/{stages[read]['writes']}/`" for read in stage["reads"]),
            f"`{stage['writes']}/`" if name in _BESIDE_THE_DATA else f"`data/{stage['writes']}/`",
            _first_sentence(root / "pipeline" / "rendezvous" / "stages" / f"{name}.py"),
        )
        for name, stage in stages.items()
    ]
    return markdown_table(("stage", "reads", "writes", "what it does"), rows)


def _first_sentence(module: Path) -> str:
    return (ast.get_docstring(ast.parse(module.read_text())) or "").splitlines()[0]


if __name__ == "__main__":
    README = ROOT / "README.md"
    README.write_text(documented(README.read_text()))
