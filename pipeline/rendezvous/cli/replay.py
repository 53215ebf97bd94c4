"""The command that makes pairs out of recorded laser logs."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from rendezvous.cli.options import CORES, Config, EngineName, Overrides, Preset, Seed, Workers, make_run


def replay(
    logs: Annotated[
        list[str] | None, typer.Argument(help="CARMEN logs or ROS bags; those of replay.logs by default.")
    ] = None,
    config: Config = None,
    preset: Preset = "default",
    overrides: Overrides = [],  # noqa: B006 - Typer reads the default, nothing writes it
    data: Annotated[
        str, typer.Option("--data", help="Data folder of its own, or a URI such as s3://bucket/replayed.")
    ] = "data/replayed",
    workers: Workers = CORES,
    seed: Seed = None,
    engine: EngineName = "local",
) -> None:
    """Make pairs out of recorded laser logs of real robots and publish them as a dataset of their own."""
    named = [f"replay.logs={json.dumps([{'path': log} for log in logs])}"] if logs else []
    run = make_run(config, preset, [*overrides, *named], data, workers, seed, engine)

    from rendezvous.stages.replay import replay as replayed

    replayed(run)
