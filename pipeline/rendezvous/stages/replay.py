"""Make pairs out of recorded laser logs: stretches of one log become two robots that meet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from rendezvous.config.sections import ReplaySection
from rendezvous.engine.run import Run, Task
from rendezvous.errors import ConfigError, LogError, SplitError, StoreError
from rendezvous.interop.laser_logs import log_digest
from rendezvous.robot_file import load_robot
from rendezvous.schema import PAIRS
from rendezvous.splits import SPLITS, split_plans
from rendezvous.stages.dataset.recorded_pairs import KnownLog, pairs_of_log
from rendezvous.stages.dataset.replay_card import replay_card_files
from rendezvous.store.disk import Disk
from rendezvous.store.read import read_manifest
from rendezvous.store.records import Inputs, Manifest
from rendezvous.store.tables import Layout, column_types

VERSION = 1
LAYOUT = Layout(item_column="plan_id", uncompressed=("map_0", "map_1", "image"), row_group_rows=256)
_NOT_IN_ROWS = {"logs", "robot", "validation_fraction", "test_fraction"}


def replay(run: Run) -> Manifest:
    """Publish the pairs of all logs, a file for each, split by building.

    Raises:
        ConfigError: no log is given, or two have one name.
        LogError: a log is missing, or none has a pair.
        SplitError: a split would be empty.
        StoreError: the folder holds a dataset of another kind.
    """
    section, seed = run.config.replay, run.config.seed
    _require_own_folder(run)
    robot = load_robot(section.robot)
    logs = _known(section)
    splits = _splits(section, logs)
    parameters = section.parameters(exclude=_NOT_IN_ROWS) | {"replay.robot": robot.parameters()}
    tasks = [
        Task(
            name=f"pairs/{split}-{number:05d}-of-{len(of_split):05d}.parquet",
            inputs=Inputs(
                parameters=parameters | log.parameters(),
                columns=column_types(PAIRS.arrow()),
                items=log.digests,
                seed=seed,
                version=VERSION,
            ),
            make=partial(pairs_of_log, log, section, robot, seed),
        )
        for split in SPLITS
        for of_split in [[log for log in logs if splits[log.building_digest] == split]]
        for number, log in enumerate(of_split)
    ]
    card = partial(replay_card_files, run, logs, splits)
    manifest = run.build("replay", tasks, layout=LAYOUT, total=len(tasks), files=card)
    _report_left_out(run, manifest)
    return manifest


def _require_own_folder(run: Run) -> None:
    folder = run.folder("replay")
    found = read_manifest(Disk(folder))
    if found is not None and found.stage != "replay":
        raise StoreError(
            f"{folder}: holds the dataset that `rendezvous {found.stage}` made; pairs of recorded logs need "
            "a data folder of their own: --data names it"
        )


def _known(section: ReplaySection) -> list[KnownLog]:
    """The logs with their digests, in the order given."""
    if not section.logs:
        raise ConfigError("replay: no log; name CARMEN logs or ROS bags, or set replay.logs")
    known: dict[str, KnownLog] = {}
    for given in section.logs:
        log = KnownLog(given=given, digests={Path(name).name: log_digest(name) for name in given.files()})
        if log.name in known:
            raise ConfigError(
                f"replay.logs: {given.path!r} and {known[log.name].given.path!r} have one name; rename one"
            )
        known[log.name] = log
    return list(known.values())


def _splits(section: ReplaySection, logs: Sequence[KnownLog]) -> Mapping[str, str]:
    """The split of each building, by its digest."""
    try:
        return split_plans(
            {log.building_digest for log in logs},
            validation_fraction=section.validation_fraction,
            test_fraction=section.test_fraction,
        )
    except SplitError as error:
        line = str(error).replace("floor plans", "buildings").replace("plans", "buildings")
        raise SplitError(f"replay: {line.replace('pack.', 'replay.')}") from error


def _report_left_out(run: Run, manifest: Manifest) -> None:
    left_out = manifest.quarantined
    if not left_out:
        return
    line = f"{len(left_out)} logs have no pairs, the first: {left_out[0].item_id}: {left_out[0].reason}"
    if not manifest.rows:
        raise LogError(f"replay: {line}")
    run.say(f"replay: {line}")
