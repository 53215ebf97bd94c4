"""Run calls on many cores: local processes, this process, or a Ray cluster.

Results come in the order in which they finish. Calls are pulled from their iterator only as workers become
free, so that a run over a large collection never holds all of them.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from enum import StrEnum
from multiprocessing.connection import wait as wait_for_any
from typing import Any, TypeVar

from rendezvous.errors import PipelineError, needs_extra

Result = TypeVar("Result")
Call = Callable[[], Result]

# One worker, one core: threads that libraries start would compete for the cores, and sums taken in another
# order could differ in their last bit.
ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "OPENCV_FOR_THREADS_NUM": "1",
    "LP_NUM_THREADS": "1",
    "RAYON_NUM_THREADS": "1",
    "ARROW_NUM_THREADS": "1",
}

WORKER_KILLED = (
    "a worker process was killed, perhaps because memory ran out; finished shards are kept: run the same "
    "command again to resume, with fewer --workers if memory is short"
)


class Engine(StrEnum):
    """Where shards are made."""

    LOCAL = "local"
    INLINE = "inline"
    RAY = "ray"


def run_calls(calls: Iterable[Call[Result]], *, engine: Engine, workers: int) -> Generator[Result]:
    """Run independent calls and yield their results as they finish.

    Args:
        calls: picklable, each independent of all others.
        engine: local processes, this process (for a debugger or profiler), or Ray.
        workers: how many run at a time.

    Raises:
        PipelineError: a worker was killed.
        SetupError: `engine` is Ray, and it is not installed.
    """
    os.environ.update(ONE_THREAD)
    match engine:
        case Engine.LOCAL:
            return _run_in_processes(calls, workers)
        case Engine.INLINE:
            return (call() for call in calls)
        case Engine.RAY:
            return _run_on_ray(calls, workers)


def _run_in_processes(calls: Iterable[Call[Result]], workers: int) -> Generator[Result]:
    context = multiprocessing.get_context("spawn")  # fork would hang after any use of GL, and copies locks
    children_before = set(multiprocessing.active_children())
    executor = ProcessPoolExecutor(workers, mp_context=context, initializer=_start_worker)
    pending: set[Future[Result]] = set()
    try:
        for call in calls:
            with _deaf_to_interrupts():
                pending.add(executor.submit(call))
            if len(pending) > workers:
                done, pending = wait(pending, return_when=FIRST_COMPLETED)
                yield from (future.result() for future in done)
        while pending:
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            yield from (future.result() for future in done)
        executor.shutdown()
    except BrokenProcessPool as error:
        raise PipelineError(WORKER_KILLED) from error
    finally:
        executor.shutdown(wait=False, cancel_futures=True)
        for child in set(multiprocessing.active_children()) - children_before:
            child.kill()
            child.join()


@contextlib.contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Block SIGINT while a worker starts; the worker inherits that and leaves Ctrl-C to its parent."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _start_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_die_with_parent, name="die-with-parent", daemon=True).start()


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait_for_any([parent.sentinel])
    os._exit(1)


def _run_on_ray(calls: Iterable[Call[Result]], workers: int) -> Generator[Result]:
    with needs_extra("ray", "--engine ray"):
        import ray
    if not ray.is_initialized():
        ray.init(
            include_dashboard=False,
            log_to_driver=False,
            logging_level=logging.ERROR,
            runtime_env={"env_vars": ONE_THREAD},
        )
    call_remotely: Any = ray.remote(num_cpus=1)(_call)
    waiting = iter(calls)
    pending = [call_remotely.remote(call) for call in itertools.islice(waiting, workers)]
    try:
        while pending:
            (done,), pending = ray.wait(pending, num_returns=1)
            pending += [call_remotely.remote(call) for call in itertools.islice(waiting, 1)]
            yield ray.get(done)
    except ray.exceptions.RayTaskError as error:
        raise error.cause from error
    except (ray.exceptions.WorkerCrashedError, ray.exceptions.OutOfMemoryError) as error:
        raise PipelineError(WORKER_KILLED) from error
    finally:
        for reference in pending:
            ray.cancel(reference, force=True)


def _call(call: Call[Result]) -> Result:
    return call()
