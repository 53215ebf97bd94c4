"""What the commands share: their common options, and what becomes of them."""

from __future__ import annotations

import os
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from rendezvous.errors import ConfigError

if TYPE_CHECKING:
    from rendezvous.engine.run import Run

Choice = TypeVar("Choice", bound=StrEnum)
CORES = len(os.sched_getaffinity(0))

Config = Annotated[str, typer.Option("--config", help="The pipeline as data.")]
Preset = Annotated[str, typer.Option("--preset", help="smoke, default, large or paper.")]
Overrides = Annotated[
    list[str], typer.Option("--set", metavar="KEY=VALUE", help="Override a parameter; may be repeated.")
]
Data = Annotated[str, typer.Option("--data", help="Data folder, or a URI such as s3://bucket/data.")]
Workers = Annotated[int, typer.Option("--workers", min=1, help="Worker processes; all cores by default.")]
Seed = Annotated[int | None, typer.Option("--seed", min=0, help="Root seed, instead of the file's.")]
EngineName = Annotated[str, typer.Option("--engine", help="local processes, inline (debugger), or ray.")]


def choice(kind: type[Choice], option: str, value: str) -> Choice:
    """A value of an enumeration that is imported only when its command runs."""
    try:
        return kind(value)
    except ValueError as error:
        known = ", ".join(kind)
        raise ConfigError(f"{option} is {value!r}; must be one of {known}") from error


def data_folder(data: str) -> str:
    """The data folder, which without a name would be the root of the file system."""
    if not data.strip():
        raise ConfigError(
            f"--data is {data!r}; must name a folder or be a URI, such as data or s3://bucket/data"
        )
    return data


def dataset_folder(data: str) -> str:
    """The published dataset in the data folder."""
    return f"{data_folder(data).rstrip('/')}/dataset"


def make_run(
    config: str, preset: str, overrides: list[str], data: str, workers: int, seed: int | None, engine: str
) -> Run:
    """The run that the options ask for; heavy modules are imported only now."""
    from rendezvous.config.load import load_config
    from rendezvous.engine.pool import Engine
    from rendezvous.engine.run import Run

    return Run(
        config=load_config(config, preset=preset, overrides=overrides, seed=seed),
        data=data_folder(data),
        workers=workers,
        engine=choice(Engine, "--engine", engine),
    )
