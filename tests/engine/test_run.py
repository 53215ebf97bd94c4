"""Shards are made once, the same way by any number of workers, and survive whatever ends a run."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest

from rendezvous.engine.pool import Engine
from rendezvous.engine.run import Task, _Work, part_name
from rendezvous.errors import PipelineError, SetupError, StoreError
from rendezvous.store.disk import Disk
from rendezvous.store.read import StageReader
from rendezvous.store.verify import verify
from rendezvous.store.write import StageWriter
from tests.conftest import PATIENCE_S, ROOT, wait_until
from tests.toy_stage import LAYOUT, STAGE, folder_content, item_names, run_of, toy_tasks


def build(data: Path | str, tasks: list[Task], *, workers: int = 1, engine: Engine = Engine.INLINE) -> str:
    """Make the toy stage's folder; gives what was said."""
    run = run_of(str(data), workers=workers, engine=engine)
    with run.console.capture() as capture:
        run.build(STAGE, tasks, layout=LAYOUT, total=len(tasks))
    return capture.get()


def toy_content(data: Path) -> dict[str, bytes]:
    return folder_content(data / STAGE)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The folder that one run makes of twelve items."""
    data = tmp_path_factory.mktemp("undisturbed")
    build(data, toy_tasks(item_names(12)))
    return toy_content(data)


@pytest.mark.parametrize("workers", [1, 3])
def test_any_number_of_worker_processes_makes_the_same_bytes(tmp_path: Path, undisturbed, workers: int):
    build(tmp_path, toy_tasks(item_names(12)), workers=workers, engine=Engine.LOCAL)
    assert toy_content(tmp_path) == undisturbed


def test_the_order_of_making_does_not_count(tmp_path: Path, undisturbed):
    tasks = toy_tasks(item_names(12))
    shuffled = random.Random(0).sample(tasks, len(tasks))
    assert shuffled != tasks
    build(tmp_path, shuffled)
    build(tmp_path, tasks)
    assert toy_content(tmp_path) == undisturbed


def test_object_storage_holds_the_same_files(tmp_path: Path, undisturbed):
    build(tmp_path.as_uri(), toy_tasks(item_names(12)))
    assert toy_content(tmp_path) == {k: v for k, v in undisturbed.items() if k != ".lock"}
    assert "0 made, 6 kept" in build(tmp_path.as_uri(), toy_tasks(item_names(12)))


def test_seed_0_and_seed_1_differ(tmp_path: Path, undisturbed):
    build(tmp_path, toy_tasks(item_names(12), seed=1))
    content = toy_content(tmp_path)
    for name in map(part_name, range(6)):
        assert content[name] != undisturbed[name]


def test_a_rerun_makes_nothing_and_touches_nothing(tmp_path: Path):
    tasks = toy_tasks(item_names(12))
    assert "6 made, 0 kept" in build(tmp_path, tasks)
    written = {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*.*") if p.name != ".lock"}
    assert "0 made, 6 kept" in build(tmp_path, tasks)
    assert {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*.*") if p.name != ".lock"} == written


def test_a_changed_parameter_is_told_once_and_makes_all_again(tmp_path: Path):
    build(tmp_path, toy_tasks(item_names(4), scale=3.0))
    said = build(tmp_path, toy_tasks(item_names(4), scale=4.0))
    assert said.count("toy.scale changed 3.0 -> 4.0") == 1
    assert "2 made, 0 kept" in said


def test_more_items_add_shards_only(tmp_path: Path):
    build(tmp_path, toy_tasks(item_names(8)))
    said = build(tmp_path, toy_tasks(item_names(12)))
    assert "2 made, 4 kept" in said
    assert "again" not in said


def test_fewer_items_remove_shards(tmp_path: Path):
    build(tmp_path, toy_tasks(item_names(12)))
    assert "0 made, 4 kept" in build(tmp_path, toy_tasks(item_names(8)))
    assert verify(str(tmp_path / STAGE)) == []
    assert len(StageReader(str(tmp_path / STAGE)).shards()) == 4


@pytest.mark.parametrize(
    ("before", "after", "made"),
    [
        (["a", "b", "c"], ["new", "a", "b", "c"], 1),
        (["a", "b", "c", "d"], ["a", "c", "d"], 0),
        (["a", "b", "c"], ["c", "b", "a"], 0),
        (["a", "b", "c"], ["b", "x", "a", "y"], 2),
    ],
)
def test_shards_that_only_moved_on_are_renamed(
    tmp_path: Path, before: list[str], after: list[str], made: int
):
    build(tmp_path / "moved", toy_tasks(before, per_shard=1))
    said = build(tmp_path / "moved", toy_tasks(after, per_shard=1))
    assert f"{made} made, {len(after) - made} kept" in said
    build(tmp_path / "fresh", toy_tasks(after, per_shard=1))
    assert toy_content(tmp_path / "moved") == toy_content(tmp_path / "fresh")


def test_two_shards_of_equal_inputs_are_both_made(tmp_path: Path):
    (task,) = toy_tasks(["a", "b"])
    twin = Task(name=part_name(1), inputs=task.inputs, make=task.make)
    assert "1 made, 0 kept" in build(tmp_path, [task])
    assert "1 made, 1 kept" in build(tmp_path, [task, twin])
    assert "0 made, 2 kept" in build(tmp_path, [task, twin])
    assert verify(str(tmp_path / STAGE)) == []


@pytest.mark.parametrize("harm", ["truncated", "altered"])
def test_a_harmed_shard_is_made_again_and_why(tmp_path: Path, undisturbed, harm: str):
    build(tmp_path, toy_tasks(item_names(12)))
    path = tmp_path / STAGE / part_name(3)
    data = path.read_bytes()
    path.write_bytes(data[:-9] if harm == "truncated" else data[:99] + bytes([data[99] ^ 1]) + data[100:])
    assert [f"file {harm}" in fault for fault in verify(str(tmp_path / STAGE))] == [True]
    said = build(tmp_path, toy_tasks(item_names(12)))
    assert f"making {part_name(3)} again: file {harm}" in said
    assert "1 made, 5 kept" in said
    assert toy_content(tmp_path) == undisturbed


def test_files_beside_the_shards_are_made_from_all_records_in_order(tmp_path: Path):
    tasks = toy_tasks(item_names(12))
    run = run_of(str(tmp_path), workers=2, engine=Engine.LOCAL)
    run.build(
        STAGE,
        tasks,
        layout=LAYOUT,
        files=lambda records: {"names": " ".join(r.name for r in records).encode()},
    )
    names = (tmp_path / STAGE / "names").read_text().split()
    assert names == [task.name for task in tasks]
    assert verify(str(tmp_path / STAGE)) == []


def test_tasks_are_pulled_only_as_workers_become_free(tmp_path: Path):
    pulled_before_made = 0
    made: list[str] = []

    def watched() -> Iterator[Task]:
        nonlocal pulled_before_made
        for pulled, task in enumerate(toy_tasks(item_names(80))):
            made[:] = [p.name for p in (tmp_path / STAGE).glob("part-*.parquet")]
            pulled_before_made = max(pulled_before_made, pulled - len(made))
            yield task

    run_of(str(tmp_path), workers=2, engine=Engine.LOCAL).build(STAGE, watched(), layout=LAYOUT)
    assert 1 <= pulled_before_made <= 3


def fail(reason: str) -> None:
    raise StoreError(reason)


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_fault_in_a_worker_ends_the_run_and_keeps_what_is_finished(tmp_path: Path, undisturbed):
    tasks = toy_tasks(item_names(12))
    tasks[4] = Task(name=tasks[4].name, inputs=tasks[4].inputs, make=partial(fail, "x: the disk is full"))
    with pytest.raises(StoreError, match="x: the disk is full"):
        build(tmp_path, tasks, workers=2, engine=Engine.LOCAL)
    assert not (tmp_path / STAGE / "manifest.json").exists()
    said = build(tmp_path, toy_tasks(item_names(12)))
    assert int(said.rpartition(" kept")[0].rpartition(" ")[2]) >= 3
    assert toy_content(tmp_path) == undisturbed


def test_a_killed_worker_is_told_in_one_line(tmp_path: Path):
    task = toy_tasks(["a"])[0]
    killed = Task(name=task.name, inputs=task.inputs, make=die)
    with pytest.raises(
        PipelineError, match="worker process was killed, perhaps because memory ran out; finished"
    ):
        build(tmp_path, [killed], workers=1, engine=Engine.LOCAL)


def test_without_ray_its_engine_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(SetupError, match=r"--engine ray needs ray, .*fusion\[ray\]"):
        build(tmp_path, toy_tasks(["a"]), engine=Engine.RAY)


def test_ray_makes_the_same_bytes_and_passes_faults_on(tmp_path: Path, undisturbed):
    pytest.importorskip("ray")
    build(tmp_path, toy_tasks(item_names(12)), workers=2, engine=Engine.RAY)
    assert toy_content(tmp_path) == undisturbed
    task = toy_tasks(["a"])[0]
    faulty = Task(name=task.name, inputs=task.inputs, make=partial(fail, "x: the disk is full"))
    with pytest.raises(StoreError, match=r"^x: the disk is full$"):
        build(tmp_path / "full", [faulty], engine=Engine.RAY)
    killed = Task(name=task.name, inputs=task.inputs, make=die)
    with pytest.raises(PipelineError, match="worker process was killed"):
        build(tmp_path / "killed", [killed], engine=Engine.RAY)


class Crash:
    """Ends the process, as `kill -9` would, at the n-th step of writing to disk."""

    def __init__(self, at: int) -> None:
        self.steps_left = at

    def step(self) -> None:
        if self.steps_left == 0:
            os._exit(9)
        self.steps_left -= 1

    def around(self, function):
        def counted(*args, **kwargs):
            self.step()
            result = function(*args, **kwargs)
            self.step()
            return result

        return counted


def build_and_crash(data: str, items: list[str], at: int) -> None:
    crash = Crash(at)
    os.fsync, os.replace = crash.around(os.fsync), crash.around(os.replace)
    Disk.move, Disk.remove = crash.around(Disk.move), crash.around(Disk.remove)
    build(data, toy_tasks(items, per_shard=1))


@pytest.mark.slow
def test_a_crash_at_any_step_of_writing_is_made_good_by_a_rerun(tmp_path: Path):
    before, after = ["a", "b", "c", "d"], ["new", "a", "c", "x"]
    build(tmp_path / "fresh", toy_tasks(after, per_shard=1))
    expected = toy_content(tmp_path / "fresh")
    build(tmp_path / "before", toy_tasks(before, per_shard=1))
    context = multiprocessing.get_context("forkserver")
    # PyArrow imports pandas where it finds it: once, not in each process that is to crash.
    context.set_forkserver_preload(["tests.engine.test_run", "pandas"])
    for at in itertools.count():
        data = tmp_path / f"crash-{at}"
        shutil.copytree(tmp_path / "before", data)
        process = context.Process(target=build_and_crash, args=(str(data), after, at))
        process.start()
        process.join()
        if process.exitcode == 0:
            break
        assert process.exitcode == 9
        if (data / STAGE / "manifest.json").exists():
            faults = verify(str(data / STAGE))
            assert all("not listed" in fault for fault in faults), f"at step {at}: {faults}"
        build(data, toy_tasks(after, per_shard=1))
        assert toy_content(data) == expected, f"after a crash at step {at}"
    assert at > 40


def start(data: Path, *arguments: str) -> subprocess.Popen:
    command = [sys.executable, "-m", "tests.toy_stage", "--data", str(data), *arguments]
    return subprocess.Popen(command, cwd=ROOT, start_new_session=True, stderr=subprocess.PIPE, text=True)


@pytest.mark.slow
def test_killing_the_process_group_at_random_moments_loses_no_finished_shard(tmp_path: Path, undisturbed):
    rng = random.Random(7)
    for parts in (1, 2, 4):
        process = start(tmp_path, "--pause-s", "0.05", "--last-pause-s", "9999")
        wait_until(lambda: len(list((tmp_path / STAGE).glob("part-*.parquet"))) >= parts, process)  # noqa: B023
        time.sleep(rng.uniform(0.0, 0.05))
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        assert process.returncode == -signal.SIGKILL
    process = start(tmp_path)
    said = process.communicate()[1]
    assert process.returncode == 0
    assert int(said.rpartition(" kept")[0].rpartition(" ")[2]) >= 3
    assert toy_content(tmp_path) == undisturbed


@pytest.mark.slow
def test_workers_end_with_the_process_that_started_them(tmp_path: Path):
    process = start(tmp_path, "--pause-s", "9999", "--items", "4")
    parent = psutil.Process(process.pid)
    wait_until(lambda: len(spawned(parent)) == 2, process)
    workers = spawned(parent)
    process.kill()
    process.communicate()
    _, alive = psutil.wait_procs(workers, timeout=PATIENCE_S)
    assert alive == []


def spawned(parent: psutil.Process) -> list[psutil.Process]:
    return [child for child in parent.children() if "spawn_main" in " ".join(child.cmdline())]


def test_what_shards_need_is_prepared_once_and_only_if_one_is_made(tmp_path: Path):
    prepared: list[bool] = []
    run = run_of(str(tmp_path))

    def build_all(tasks: list[Task]) -> None:
        made = (tmp_path / STAGE).glob("part-*.parquet")
        run.build(STAGE, tasks, layout=LAYOUT, prepare=lambda: prepared.append(any(made)))

    build_all(toy_tasks(item_names(6)))
    assert prepared == [False]  # before the first one
    build_all(toy_tasks(item_names(6)))
    assert len(prepared) == 1
    build_all(toy_tasks(item_names(8)))
    assert len(prepared) == 2


def test_a_shard_whose_columns_are_not_those_of_its_inputs_is_never_written(tmp_path: Path):
    (task,) = toy_tasks(["a"])
    other = {**task.inputs.columns, "values": "list<float>"}
    wrong = Task(name=task.name, inputs=replace(task.inputs, columns=other), make=task.make)
    with pytest.raises(AssertionError, match=r"part-00000\.parquet: columns of its inputs"):
        build(tmp_path, [wrong])
    assert not (tmp_path / STAGE / task.name).exists()


def test_a_worker_gets_a_writer_without_the_index_of_all_shards(tmp_path: Path):
    build(tmp_path, toy_tasks(item_names(6)))
    writer = StageWriter(str(tmp_path / STAGE), STAGE, LAYOUT)
    with writer.locked():
        assert len(writer._by_fingerprint) == 3
        assert writer.for_worker() == StageWriter(writer.root, STAGE, LAYOUT)


def test_a_stages_folder_is_in_the_data_folder_however_that_is_written():
    assert run_of("somewhere/").folder(STAGE) == run_of("somewhere").folder(STAGE) == f"somewhere/{STAGE}"
    assert [part_name(n) for n in (0, 42, 123456)] == [
        "part-00000.parquet", "part-00042.parquet", "part-123456.parquet"
    ]  # fmt: skip


def test_shards_are_reported_as_kept_or_made_with_their_rows(tmp_path: Path):
    build(tmp_path, toy_tasks(item_names(3)))
    advanced: list[tuple[int, bool]] = []
    report = SimpleNamespace(
        advance=lambda rows, *, made: advanced.append((rows, made)), say=lambda line: None
    )
    writer = StageWriter(str(tmp_path / STAGE), STAGE, LAYOUT)
    with writer.locked():
        work = _Work(writer, report)
        (call,) = work.calls(toy_tasks(item_names(5))[:1] + toy_tasks(item_names(5))[2:], lambda: None)
        work.made(call())
    assert advanced == [(6, False), (3, True)]
    assert [record.name for record in work.records_in_order()] == [part_name(0), part_name(2)]
