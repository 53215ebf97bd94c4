"""A budget that is too small for one step."""

from __future__ import annotations

from pathlib import Path

from typer.testing import CliRunner

from rendezvous.cli.__main__ import app
from rendezvous.stages.training.train_record import CHECKPOINT, CURVE, WEIGHTS
from tests.stages.test_train import command


def test_a_budget_that_ends_before_the_first_step_is_refused_and_nothing_overwritten(
    data: Path, tmp_path: Path
):
    (tmp_path / WEIGHTS).write_bytes(b"those of before")
    done = CliRunner().invoke(
        app, [*command(data, tmp_path), "--set", "train.minutes=1e-9", "--set", "train.samples=null"]
    )
    assert done.exit_code == 2
    assert (
        "not one step was made within 1e-09 minutes, so nothing is written; raise train.minutes"
        in done.output
    )
    assert (tmp_path / WEIGHTS).read_bytes() == b"those of before"
    assert not (tmp_path / CHECKPOINT).exists()
    assert not (tmp_path / CURVE).exists()
