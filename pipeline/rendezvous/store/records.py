"""Records of shards: inputs, content, and the items left out."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import pyarrow as pa

from rendezvous.store.json_types import require_file_name, require_types, require_values

RECORD_FOLDER = ".shards"
MANIFEST = "manifest.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class Quarantined:
    """An item that was left out, why, and where the fault is."""

    item_id: str
    reason: str
    where: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shard:
    """What a stage makes from a shard's items."""

    table: pa.Table
    counts: Mapping[str, int] = field(default_factory=dict)  # as of "pairs"; the manifest sums them
    quarantined: tuple[Quarantined, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Inputs:
    """Everything that a shard's content depends on: equal inputs give equal shards."""

    # By full key in `stages.yaml`; nested mappings are flattened, tuples become lists.
    parameters: Mapping[str, Any]
    items: Mapping[str, str]  # digest of each item's input, by item id, in order
    # Type of each column written, from `column_types`; empty in records older than this field.
    columns: Mapping[str, str] = field(default_factory=dict)
    seed: int | None = None  # root seed; None if the content does not depend on it
    version: int = 1  # of the stage's code, raised when a change of code changes its output

    def __post_init__(self) -> None:
        # In the form in which records hold them, so that old and new compare.
        object.__setattr__(self, "parameters", json.loads(json.dumps(dotted(self.parameters))))

    def fingerprint(self) -> str:
        columns = list(self.columns.items())
        return digest_of([self.version, self.seed, dict(self.parameters), columns, list(self.items.items())])

    def differs_in_items_only(self, other: Inputs) -> bool:
        """Whether the same code, columns, parameters and seed, where both have them, made other items."""
        shared = self.parameters.keys() & other.parameters.keys()
        return (
            self.version == other.version
            and self.columns == other.columns
            and (None in (self.seed, other.seed) or self.seed == other.seed)
            and all(self.parameters[key] == other.parameters[key] for key in shared)
            and self.items != other.items
        )

    def changes_since(self, old: Inputs) -> list[str]:
        """The differences from the inputs of an older shard, in words."""
        changes = []
        if old.version != self.version:
            changes.append(f"the stage's version changed {old.version} -> {self.version}")
        if old.seed != self.seed:
            changes.append(f"seed changed {old.seed} -> {self.seed}")
        for key in sorted({*old.parameters, *self.parameters}):
            before, after = old.parameters.get(key), self.parameters.get(key)
            if before != after:
                changes.append(f"{key} changed {before} -> {after}")
        if self.columns and not old.columns:
            changes.append("its columns were not recorded")
        else:
            changes += _changes("columns", old.columns, self.columns)
        return changes + _changes("upstream", old.items, self.items)


def _changes(of: str, old: Mapping[str, str], new: Mapping[str, str]) -> list[str]:
    changed = [f"{of}: {name} changed" for name in new if name in old and old[name] != new[name]]
    added = [f"{of}: {name} is new" for name in new if name not in old]
    gone = [f"{of}: {name} is gone" for name in old if name not in new]
    changes = changed + added + gone
    return changes if changes or list(old) == list(new) else [f"{of}: the order changed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ShardRecord:
    """A finished shard."""

    name: str  # its file, relative to the stage's folder
    # bytes, sha256: of the file.
    bytes: int
    sha256: str
    content_digest: str  # of the rows, whatever the version of pyarrow
    rows: int  # number of rows
    # counts, quarantined: as in `Shard`.
    counts: Mapping[str, int]
    quarantined: tuple[Quarantined, ...]
    items: Mapping[str, str]  # digest of each item's rows, by id; the input of later stages
    inputs: Inputs  # what the shard was made from
    versions: Mapping[str, str]  # of the packages that made it

    @staticmethod
    def record_name(shard_name: str) -> str:
        """The file that holds a shard's record."""
        return f"{RECORD_FOLDER}/{shard_name}.json"

    @classmethod
    def from_json(cls, fields: Mapping[str, Any]) -> ShardRecord:
        """Inverse of `asdict`.

        Raises:
            AttributeError, KeyError, TypeError, ValueError: the fields are those of no record.
        """
        require_types(fields, name=str, bytes=int, sha256=str, content_digest=str, rows=int, quarantined=list)
        require_values(fields, counts=int, items=str, versions=str)
        require_file_name(fields["name"])
        inputs = fields["inputs"]
        require_types(inputs, parameters=dict, version=int)
        require_values({"columns": {}, **inputs}, items=str, columns=str)
        if inputs.get("seed") is not None:
            require_types(inputs, seed=int)
        json.dumps(inputs["parameters"], allow_nan=False)
        for entry in fields["quarantined"]:
            require_types(entry, **dict.fromkeys(entry, str))
        quarantined = tuple(Quarantined(**entry) for entry in fields["quarantined"])
        return cls(**{**fields, "inputs": Inputs(**inputs), "quarantined": quarantined})


@dataclass(frozen=True, slots=True, kw_only=True)
class FileRecord:
    """A file beside the shards, such as the dataset's card."""

    name: str
    bytes: int
    sha256: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Manifest:
    """A stage's finished output: its shards and the files beside them."""

    stage: str
    shards: tuple[ShardRecord, ...]
    files: tuple[FileRecord, ...] = ()

    @property
    def rows(self) -> int:
        return sum(shard.rows for shard in self.shards)

    @property
    def quarantined(self) -> tuple[Quarantined, ...]:
        return tuple(entry for shard in self.shards for entry in shard.quarantined)

    def counts(self) -> dict[str, int]:
        """The sums of the shards' counts."""
        totals = Counter[str]()
        for shard in self.shards:
            totals.update(shard.counts)
        return dict(totals)

    def to_json(self) -> dict[str, Any]:
        """The manifest as written. What most shards share stands once, and shards refer to it by digest."""
        shared: dict[str, dict[str, Any]] = {"parameters": {}, "columns": {}, "versions": {}}
        shards = [asdict(shard) for shard in self.shards]
        for entry in shards:
            for key, place in (
                ("parameters", entry["inputs"]),
                ("columns", entry["inputs"]),
                ("versions", entry),
            ):
                digest = digest_of(place[key])
                shared[key][digest], place[key] = place[key], digest
        return {
            "stage": self.stage,
            "rows": self.rows,
            "counts": self.counts(),
            "quarantined": len(self.quarantined),
            **shared,
            "files": [asdict(file) for file in self.files],
            "shards": shards,
        }

    @classmethod
    def from_json(cls, fields: Mapping[str, Any]) -> Manifest:
        """Inverse of `to_json`.

        Raises:
            AttributeError, KeyError, TypeError, ValueError: the fields are those of no manifest.
        """
        require_types(fields, stage=str)
        for entry in fields["files"]:
            require_types(entry, name=str, bytes=int, sha256=str)
            require_file_name(entry["name"])
        shards = []
        for entry in fields["shards"]:
            inputs = dict(entry["inputs"])
            inputs["parameters"] = fields["parameters"][inputs["parameters"]]
            if "columns" in inputs:  # older manifests have none
                inputs["columns"] = fields["columns"][inputs["columns"]]
            versions = fields["versions"][entry["versions"]]
            shards.append(ShardRecord.from_json({**entry, "inputs": inputs, "versions": versions}))
        files = tuple(FileRecord(**entry) for entry in fields["files"])
        return cls(stage=fields["stage"], shards=tuple(shards), files=files)


def dotted(values: Mapping[str, Any]) -> dict[str, Any]:
    """Nested mappings flattened: `{"a": {"b": 1}}` becomes `{"a.b": 1}`."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            flat |= {f"{key}.{below}": leaf for below, leaf in dotted(value).items()}
        else:
            flat[key] = value
    return flat


def digest_of(value: Any) -> str:
    """SHA-256 of a JSON value; the order of a mapping's keys does not count."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def json_bytes(value: Any) -> bytes:
    """JSON as it is written to disk; half a character, as of a name that is not UTF-8, is escaped."""
    text = json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False)
    return f"{text}\n".encode(errors="backslashreplace")
