"""Make a stage's shards: skip those that are finished, run the rest on workers, publish the manifest."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

from rich.console import Console

from rendezvous.config.load import Config
from rendezvous.engine.pool import Call, Engine, run_calls
from rendezvous.engine.progress import Meter, meter
from rendezvous.store.read import StageReader
from rendezvous.store.records import Inputs, Manifest, Shard, ShardRecord
from rendezvous.store.tables import Layout, column_types
from rendezvous.store.write import NOT_MADE_YET, StageWriter


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """One shard to make."""

    name: str  # its file, relative to the stage's folder
    inputs: Inputs  # all that its content depends on
    make: Callable[[], Shard]  # makes the content; picklable, and a pure function of `inputs`


def part_name(index: int) -> str:
    """File name of a stage's shard by its number."""
    return f"part-{index:05d}.parquet"


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """One run of the pipeline: its configuration, its data folder and its workers."""

    config: Config
    data: str
    workers: int
    engine: Engine = Engine.LOCAL
    console: Console = field(default_factory=lambda: Console(stderr=True))

    def folder(self, stage: str) -> str:
        """The folder of a stage's output."""
        return f"{self.data.rstrip('/')}/{self.config.stages[stage].writes}"

    def read(self, stage: str) -> StageReader:
        """The output of an earlier stage."""
        return StageReader(self.folder(stage), stage)

    def say(self, line: str) -> None:
        """Print a line above the progress bar."""
        self.console.print(line, highlight=False, markup=False, soft_wrap=True)

    def build(
        self,
        stage: str,
        tasks: Iterable[Task],
        *,
        layout: Layout,
        total: int | None = None,
        prepare: Callable[[], None] = lambda: None,
        files: Callable[[Sequence[ShardRecord]], Mapping[str, bytes]] = lambda records: {},
    ) -> Manifest:
        """Make a stage's output from its shards.

        Args:
            stage: its name in `stages.yaml`.
            tasks: its shards, in order; pulled only as workers become free.
            layout: how its tables are stored as Parquet.
            total: number of shards, None if that is not known beforehand.
            prepare: called once, before the first shard that has to be made.
            files: makes the files beside the shards, such as a card, from all records in order.

        Raises:
            PipelineError: the disk is full, a worker was killed, or another run is writing here.
        """
        writer = StageWriter(self.folder(stage), stage, layout)
        with writer.locked(), meter(stage, total=total, console=self.console) as report:
            started_s = time.monotonic()
            work = _Work(writer, report)
            results = run_calls(work.calls(tasks, prepare), engine=self.engine, workers=self.workers)
            with contextlib.closing(results):
                for record in results:
                    work.made(record)
            records = work.records_in_order()
            manifest = writer.finish(records, files(records))
            report.say(work.summary(manifest, elapsed_s=time.monotonic() - started_s))
        return manifest


class _Work:
    """The shards of one stage: which are finished, which have to be made, and why."""

    def __init__(self, writer: StageWriter, report: Meter) -> None:
        self._writer = writer
        self._report = report
        self._records: dict[str, ShardRecord | None] = {}
        self._kept = 0
        self._reasons = {NOT_MADE_YET}

    def calls(self, tasks: Iterable[Task], prepare: Callable[[], None]) -> Iterator[Call[ShardRecord]]:
        """Calls that make the shards that are not finished."""
        prepared = False
        for task in tasks:
            record = self._writer.finished(task.name, task.inputs)
            self._records[task.name] = record
            if record is not None:
                self._kept += 1
                self._report.advance(record.rows, made=False)
                continue
            if not prepared:
                prepare()
                prepared = True
            self._say_why(task.name, self._writer.reason_to_make(task.name, task.inputs))
            self._writer.make_room(task.name, task.inputs)
            yield partial(_make_and_write, self._writer.for_worker(), task)

    def made(self, record: ShardRecord) -> None:
        self._records[record.name] = record
        self._report.advance(record.rows, made=True)

    def records_in_order(self) -> list[ShardRecord]:
        return [record for record in self._records.values() if record is not None]

    def summary(self, manifest: Manifest, *, elapsed_s: float) -> str:
        """One line: the counts of rows, the shards made and kept, and the time it took."""
        made = len(manifest.shards) - self._kept
        counts = ", ".join(f"{count} {name}" for name, count in manifest.counts().items())
        return (
            f"{manifest.stage}: {counts or f'{manifest.rows} rows'} in {len(manifest.shards)} shards; "
            f"{made} made, {self._kept} kept, {elapsed_s:.1f} s"
        )

    def _say_why(self, name: str, reason: str) -> None:
        """Say why a shard is made again, once per reason: a changed parameter concerns all shards."""
        if reason not in self._reasons:
            self._reasons.add(reason)
            self._report.say(f"{self._writer.stage}: making {name} again: {reason}")


def _make_and_write(writer: StageWriter, task: Task) -> ShardRecord:
    shard = task.make()
    # A shard is kept as long as its inputs are the same: what it holds must follow from them.
    assert column_types(shard.table.schema) == dict(task.inputs.columns), (
        f"{task.name}: columns of its inputs"
    )
    return writer.write(task.name, task.inputs, shard)
