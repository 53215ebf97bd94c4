"""The command that draws a sheet of robots of one family."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rendezvous.cli.options import Config, Overrides, Preset, Seed


def robot_sheet(
    config: Config = None,
    preset: Preset = "default",
    overrides: Overrides = [],  # noqa: B006 - Typer reads the default, nothing writes it
    seed: Seed = None,
    count: Annotated[int, typer.Option("--count", min=1, help="Number of robots.")] = 48,
    out: Annotated[Path, typer.Option("--out", help="PNG to write.")] = Path("robots.png"),
) -> None:
    """Draw robots as training images show them: explore.robot and what render.draws.robot lets differ."""
    from rendezvous.commands.robot_sheet import write_robot_sheet
    from rendezvous.config.load import load_config
    from rendezvous.resources import located

    loaded = load_config(config or located("stages.yaml"), preset=preset, overrides=overrides, seed=seed)
    robot, draws = loaded.explore.robot, loaded.render.draws.robot
    print(write_robot_sheet(robot, draws, out, count=count, seed=loaded.seed))
