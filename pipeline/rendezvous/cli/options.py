"""Options that several commands share, and what they are turned into."""

from __future__ import annotations

import os
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from rendezvous.errors import ConfigError
from rendezvous.resources import located

if TYPE_CHECKING:
    from rendezvous.engine.run import Run

Choice = TypeVar("Choice", bound=StrEnum)
CORES = len(os.sched_getaffinity(0))

Config = Annotated[
    str | None,
    typer.Option("--config", help="Stages and parameters; stages.yaml here, or else the shipped one."),
]
Preset = Annotated[
    str,
    typer.Option(
        "--preset", help="A preset of the configuration: smoke, default, poses, pathtraced, large, paper."
    ),
]
Overrides = Annotated[
    list[str], typer.Option("--set", metavar="KEY=VALUE", help="Override a parameter; may be repeated.")
]
Data = Annotated[str, typer.Option("--data", help="Data folder, or a URI such as s3://bucket/data.")]
Workers = Annotated[int, typer.Option("--workers", min=1, help="Worker processes; all cores by default.")]
Seed = Annotated[int | None, typer.Option("--seed", min=0, help="Root seed, instead of the file's.")]
EngineName = Annotated[str, typer.Option("--engine", help="local processes, inline (debugger), or ray.")]


def choice(kind: type[Choice], option: str, value: str) -> Choice:
    """An option's value as a member of `kind`, which is imported only when the command runs.

    Raises:
        ConfigError: `kind` has no such member.
    """
    try:
        return kind(value)
    except ValueError as error:
        known = ", ".join(kind)
        raise ConfigError(f"{option} is {value!r}; must be one of {known}") from error


def data_folder(data: str) -> str:
    """The folder that `--data` names.

    Raises:
        ConfigError: the name is empty, which would mean the root of the file system.
    """
    if not data.strip():
        raise ConfigError(
            f"--data is {data!r}; must name a folder or be a URI, such as data or s3://bucket/data"
        )
    return data


def dataset_folder(data: str) -> str:
    """Folder of the published dataset in the folder that `--data` names."""
    return f"{data_folder(data).rstrip('/')}/dataset"


def make_run(
    config: str | None,
    preset: str,
    overrides: list[str],
    data: str,
    workers: int,
    seed: int | None,
    engine: str,
) -> Run:
    """The run that the options ask for; imports heavy modules only now."""
    from rendezvous.config.load import load_config
    from rendezvous.engine.pool import Engine
    from rendezvous.engine.run import Run

    return Run(
        config=load_config(config or located("stages.yaml"), preset=preset, overrides=overrides, seed=seed),
        data=data_folder(data),
        workers=workers,
        engine=choice(Engine, "--engine", engine),
    )
