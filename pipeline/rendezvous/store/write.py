"""Write a stage's output: keep finished shards, replace stale ones, publish the manifest last."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from importlib import metadata

from rendezvous.errors import StoreError
from rendezvous.store.disk import TEMPORARY_PATTERN, Disk
from rendezvous.store.read import read_manifest, read_record
from rendezvous.store.records import (
    MANIFEST,
    RECORD_FOLDER,
    FileRecord,
    Inputs,
    Manifest,
    Shard,
    ShardRecord,
    json_bytes,
)
from rendezvous.store.tables import Layout, content_digest, item_digests, parquet_bytes

LOCK = ".lock"
NOT_MADE_YET = "not made yet"
# Packages that can change a byte of the data; their versions are recorded with each shard.
RECORDED_PACKAGES = (
    "rendezvous-fusion",
    "mujoco",
    "numba",
    "numpy",
    "opencv-python-headless",
    "pyarrow",
    "shapely",
    "trimesh",
)


@cache
def _versions() -> dict[str, str]:
    """Looked up once: it takes longer than writing a small shard."""
    return {package: metadata.version(package) for package in RECORDED_PACKAGES}


@dataclass(slots=True)
class StageWriter:
    """Writes one stage's folder. The run's own process plans and finishes; workers write shards."""

    root: str
    stage: str
    layout: Layout = field(default_factory=Layout)
    _by_fingerprint: dict[str, str] = field(default_factory=dict, repr=False)
    _claimed: set[str] = field(default_factory=set, repr=False)
    _published: set[str] = field(default_factory=set, repr=False)

    def for_worker(self) -> StageWriter:
        """A copy without the index, small to send to a worker."""
        return StageWriter(self.root, self.stage, self.layout)

    @property
    def disk(self) -> Disk:
        return Disk(self.root)

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other runs out of the folder, and remove the half-written files of a killed run.

        Raises:
            StoreError: another run is writing here.
        """
        with self._lock():
            self._remove_temporaries()
            self._index()
            try:
                yield
            finally:
                self._remove_temporaries()

    @contextlib.contextmanager
    def _lock(self) -> Iterator[None]:
        disk = self.disk
        if disk.is_uri:  # object storage knows no locks
            yield
            return
        try:
            os.makedirs(disk.path(), exist_ok=True)
            lock = open(disk.path(LOCK), "w")  # noqa: SIM115 - closed below, where the lock ends
        except OSError as error:
            raise StoreError(f"{disk.shown()}: cannot be written ({error.strerror})") from error
        with lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise StoreError(f"{disk.shown()}: another run is writing here; wait or stop it") from error
            yield

    def _remove_temporaries(self) -> None:
        for name in self.disk.names():
            if TEMPORARY_PATTERN.fullmatch(name):
                self.disk.remove(name)

    def _index(self) -> None:
        with contextlib.suppress(StoreError):  # a damaged manifest says nothing; the records do
            manifest = read_manifest(self.disk)
            self._published = listed_names(manifest) if manifest is not None else set()
        for name in _recorded_names(self.disk.names()):
            record = read_record(self.disk, name)
            # A killed run may leave the record of a shard that it did not write.
            if record is not None and self.disk.size(name) == record.bytes:
                self._by_fingerprint[record.inputs.fingerprint()] = name

    def finished(self, name: str, inputs: Inputs) -> ShardRecord | None:
        """The shard with these inputs, if it exists; one with another number is renamed."""
        self._claimed.add(name)
        record = self._sound_record(name, inputs)
        if record is not None:
            return record
        other_name = self._by_fingerprint.get(inputs.fingerprint(), name)
        if other_name in self._claimed:
            return None
        record = self._sound_record(other_name, inputs)
        return None if record is None else self._renamed(record, name)

    def _sound_record(self, name: str, inputs: Inputs) -> ShardRecord | None:
        record = read_record(self.disk, name)
        if record is None or record.inputs.fingerprint() != inputs.fingerprint() or self._damage(record):
            return None
        return record

    def reason_to_make(self, name: str, inputs: Inputs) -> str:
        """Why a shard has to be made, in words."""
        record = read_record(self.disk, name)
        if record is None:
            return NOT_MADE_YET if self.disk.size(name) is None else "no record that it was finished"
        changes = inputs.changes_since(record.inputs)
        return _summarised(changes) if changes else self._damage(record) or NOT_MADE_YET

    def make_room(self, name: str, inputs: Inputs) -> None:
        """Before a shard is made: withdraw the manifest, and set aside a shard of other items.

        A new floor plan moves the items after it by one; `finished` finds their shards under the new number.
        """
        self._unpublish()
        record = read_record(self.disk, name)
        if record is not None and record.inputs.differs_in_items_only(inputs) and not self._damage(record):
            self._renamed(record, f"{RECORD_FOLDER}/aside-{record.inputs.fingerprint()[:16]}.parquet")

    def _damage(self, record: ShardRecord) -> str | None:
        return damage(self.disk, record.name, record.bytes, record.sha256)

    def _renamed(self, record: ShardRecord, name: str) -> ShardRecord:
        self.make_room(name, record.inputs)
        renamed = replace(record, name=name)
        self.disk.write(ShardRecord.record_name(name), json_bytes(asdict(renamed)))
        self.disk.move(record.name, name)
        self.disk.remove(ShardRecord.record_name(record.name))
        self._by_fingerprint[record.inputs.fingerprint()] = name
        return renamed

    def _unpublish(self) -> None:
        if self.disk.size(MANIFEST) is not None:
            self.disk.remove(MANIFEST)

    def write(self, name: str, inputs: Inputs, shard: Shard) -> ShardRecord:
        """Write a shard's record, then the shard.

        In this order every shard has a record, and a later run never takes a stranger's file for its own.
        """
        table, layout = shard.table, self.layout
        data = parquet_bytes(table, layout)
        record = ShardRecord(
            name=name,
            bytes=data.size,
            sha256=hashlib.sha256(data).hexdigest(),
            content_digest=content_digest(table),
            rows=table.num_rows,
            counts=dict(shard.counts),
            quarantined=shard.quarantined,
            items=(
                item_digests(table, layout.item_column, columns=layout.identity) if layout.item_column else {}
            ),
            inputs=inputs,
            versions=dict(_versions()),
        )
        self.disk.write(ShardRecord.record_name(name), json_bytes(asdict(record)))
        self.disk.write(name, data)
        return record

    def finish(self, records: Sequence[ShardRecord], files: Mapping[str, bytes]) -> Manifest:
        """Write the files beside the shards, remove stale files of ours, publish the manifest."""
        manifest = Manifest(
            stage=self.stage,
            shards=tuple(records),
            files=tuple(
                FileRecord(name=name, bytes=len(data), sha256=hashlib.sha256(data).hexdigest())
                for name, data in files.items()
            ),
        )
        published = json_bytes(manifest.to_json())
        if self.disk.size(MANIFEST) is None or self.disk.read(MANIFEST) != published:
            self._unpublish()
        self._remove_stale(listed_names(manifest))
        for file in manifest.files:
            if damage(self.disk, file.name, file.bytes, file.sha256):
                self.disk.write(file.name, files[file.name])
        if self.disk.size(MANIFEST) is None:
            self.disk.write(MANIFEST, published)
        return manifest

    def _remove_stale(self, wanted: set[str]) -> None:
        """Remove what earlier runs listed and this one does not; other files are not ours."""
        names = self.disk.names()
        shards = _recorded_names(names)
        records = [ShardRecord.record_name(name) for name in shards]
        # The shard before its record: if the run is killed in between, the shard is still known.
        for name in dict.fromkeys([*sorted(self._published - {*records}), *shards, *records]):
            if name in names and name not in wanted:
                self.disk.remove(name)


def listed_names(manifest: Manifest) -> set[str]:
    """The names of all files in a finished folder."""
    shards = [shard.name for shard in manifest.shards]
    records = [ShardRecord.record_name(name) for name in shards]
    return {MANIFEST, LOCK, *shards, *records, *(file.name for file in manifest.files)}


def _recorded_names(names: Sequence[str]) -> list[str]:
    """The shards that have a record, from the names of all files in a folder."""
    head, tail = f"{RECORD_FOLDER}/", ".json"
    records = [name for name in names if name.startswith(head) and name.endswith(f".parquet{tail}")]
    return [name.removeprefix(head).removesuffix(tail) for name in records]


def damage(disk: Disk, name: str, size_bytes: int, sha256: str) -> str | None:
    """The fault of a file, in words; None if it is as it was written."""
    size = disk.size(name)
    if size is None:
        return "file missing"
    if size != size_bytes:
        verb = "truncated" if size < size_bytes else "grown"
        return f"file {verb}: {size} bytes, should be {size_bytes}"
    found = disk.sha256(name)
    return None if found == sha256 else f"file altered: sha256 {found[:12]}…, should be {sha256[:12]}…"


def _summarised(changes: Sequence[str], *, most: int = 3) -> str:
    more = f" and {len(changes) - most} more" if len(changes) > most else ""
    return "; ".join(changes[:most]) + more
