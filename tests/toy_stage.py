"""A stage in small, to try the shell on: three rows per item, drawn from the item's own stream.

As a program it writes a folder with worker processes: `python -m tests.toy_stage --data DIR`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import pyarrow as pa
from rich.console import Console

from rendezvous.engine.pool import Engine
from rendezvous.engine.run import Run, Task, part_name
from rendezvous.seeds import stream
from rendezvous.store.records import Inputs, Quarantined, Shard
from rendezvous.store.tables import Layout
from tests.conftest import smoke_config

STAGE = "floorplans"  # its folder; what is written there is ours
LAYOUT = Layout(item_column="item", uncompressed=("blob",))


def toy_shard(items: Sequence[str], seed: int, scale: float, pause_s: float) -> Shard:
    time.sleep(pause_s)
    rows = []
    for item in items:
        rng = stream(seed, "toy", item)
        rows += [
            {"item": item, "values": (scale * rng.random(4)).tolist(), "blob": rng.bytes(2000)}
            for _ in range(3)
        ]
    return Shard(
        table=pa.Table.from_pylist(rows),
        counts={"items": len(items)},
        quarantined=(Quarantined(item_id=f"{items[0]}-twin", reason="it has a twin"),),
    )


def toy_tasks(
    items: Sequence[str], *, seed: int = 0, scale: float = 1.0, pause_s: float = 0.0, per_shard: int = 2
) -> list[Task]:
    batches = [tuple(items[i : i + per_shard]) for i in range(0, len(items), per_shard)]
    return [
        Task(
            name=part_name(index),
            inputs=Inputs(
                parameters={"toy.scale": scale},
                columns={"item": "string", "values": "list<double>", "blob": "binary"},
                items={item: f"content of {item}" for item in batch},
                seed=seed,
            ),
            make=partial(toy_shard, batch, seed, scale, pause_s),
        )
        for index, batch in enumerate(batches)
    ]


def item_names(count: int) -> list[str]:
    return [f"item-{index}" for index in range(count)]


def folder_content(folder: str | Path) -> dict[str, bytes]:
    """Every file of a folder by its name, hidden ones too."""
    root = Path(folder)
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def run_of(data: str, *, workers: int = 1, engine: Engine = Engine.INLINE) -> Run:
    return Run(config=smoke_config(), data=data, workers=workers, engine=engine, console=Console(stderr=True))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--data", required=True)
    parser.add_argument("--items", type=int, default=12)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--pause-s", type=float, default=0.0)
    parser.add_argument("--last-pause-s", type=float, help="of the last shard, to be killed at")
    arguments = parser.parse_args()
    run = run_of(arguments.data, workers=arguments.workers, engine=Engine.LOCAL)
    tasks = toy_tasks(item_names(arguments.items), pause_s=arguments.pause_s)
    if arguments.last_pause_s is not None:
        last = toy_tasks(item_names(arguments.items), pause_s=arguments.last_pause_s)[-1]
        tasks = [*tasks[:-1], last]
    run.build(STAGE, tasks, layout=LAYOUT, total=len(tasks))


if __name__ == "__main__":
    main()
