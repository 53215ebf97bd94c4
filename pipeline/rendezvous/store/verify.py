"""Find damaged, missing and unlisted files in finished folders."""

from __future__ import annotations

from pathlib import PurePosixPath

from rendezvous.errors import StoreError
from rendezvous.store.disk import Disk
from rendezvous.store.read import read_manifest, read_record
from rendezvous.store.records import MANIFEST, RECORD_FOLDER, FileRecord, ShardRecord
from rendezvous.store.write import damage, listed_names


def stage_folders(root: str) -> list[str]:
    """The stages' folders at or below `root`.

    Raises:
        StoreError: there is none.
    """
    tops = set()
    for name in Disk(root).names():
        parts = PurePosixPath(name).parts
        if RECORD_FOLDER in parts:
            tops.add("/".join(parts[: parts.index(RECORD_FOLDER)]))
        elif parts[-1] == MANIFEST:
            tops.add("/".join(parts[:-1]))
    if not tops:
        raise StoreError(f"{root}: no stage's output here; `rendezvous dataset` makes some")
    return sorted(f"{root.rstrip('/')}/{top}" if top else root for top in tops)


def verify(root: str) -> list[str]:
    """The faults of one stage's folder, a line each; [] if it is sound."""
    disk = Disk(root)
    try:
        manifest = read_manifest(disk)
    except StoreError as error:
        return [str(error)]
    if manifest is None:
        return [f"{disk.shown(MANIFEST)}: missing, so the stage has not finished; run it again to resume"]
    written: list[ShardRecord | FileRecord] = [*manifest.shards, *manifest.files]
    faults = [(file.name, damage(disk, file.name, file.bytes, file.sha256)) for file in written]
    for shard in manifest.shards:
        if read_record(disk, shard.name) != shard:
            faults.append((shard.record_name(shard.name), f"missing or differs from {MANIFEST}"))
    unlisted = [name for name in disk.names() if name not in listed_names(manifest)]
    faults += [(name, f"not listed in {MANIFEST}") for name in unlisted]
    return [f"{disk.shown(name)}: {fault}" for name, fault in faults if fault]
