"""The files beside the pairs of recorded logs: the card and its pictures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import pyarrow as pa

from rendezvous.engine.run import Run
from rendezvous.evaluation.dataset.card import CARD_COLUMNS, overlap_chart
from rendezvous.evaluation.dataset.replay_card import LogEntry, replay_card
from rendezvous.evaluation.dataset.sampling import ROW, SHARD, evenly_by, rows_at
from rendezvous.evaluation.pictures.canvas import encoded_png
from rendezvous.evaluation.pictures.pairs import contact_sheet
from rendezvous.schema import PAIRS
from rendezvous.stages.dataset.recorded_pairs import KnownLog
from rendezvous.store.read import StageReader
from rendezvous.store.records import ShardRecord

_PICTURED = 3


def replay_card_files(
    run: Run, logs: Sequence[KnownLog], splits: Mapping[str, str], records: Sequence[ShardRecord]
) -> Mapping[str, bytes]:
    """The card and its pictures, by name; none without a pair."""
    reader = StageReader(run.folder("replay"), "replay")
    sightings = _sightings(reader, records)
    if not sightings.num_rows:
        return {}
    counts: Counter[str] = Counter()
    for record in records:
        counts.update(record.counts)
    pairs = {name: record.rows for record in records for name in list(record.inputs.items)[:1]}
    text = replay_card(
        sightings,
        [_entry(log, splits, pairs) for log in logs],
        counts=counts,
        left_out=[fault for record in records for fault in record.quarantined],
        parameters={
            key: value
            for record in records
            for key, value in record.inputs.parameters.items()
            if not key.startswith("replay.log.")
        }
        | run.config.replay.parameters(exclude={"robot"}),
        versions=records[0].versions,
        bytes_total=sum(record.bytes for record in records),
    )
    shown = sightings.take(evenly_by(sightings["overlap"].to_numpy(), _PICTURED))
    subtitle = f"{shown.num_rows} of {sightings.num_rows} pairs, from low to high overlap"
    sheet = contact_sheet(rows_at(reader, shown, PAIRS), title="Rendezvous, recorded", subtitle=subtitle)
    return {
        "README.md": text.encode(),
        "pairs.png": encoded_png(sheet),
        "overlap.png": encoded_png(overlap_chart(sightings)),
    }


def _entry(log: KnownLog, splits: Mapping[str, str], pairs: Mapping[str, int]) -> LogEntry:
    file = Path(log.given.path).name
    return LogEntry(
        file=file,
        building=log.building,
        split=splits[log.building_digest],
        sha256=log.sha256,
        pairs=pairs.get(file, 0),
    )


def _sightings(reader: StageReader, records: Sequence[ShardRecord]) -> pa.Table:
    """The card's columns of all pairs, with their split and place."""
    tables = []
    for record in records:
        table = reader.table(record.name, columns=list(CARD_COLUMNS))
        split = record.name.removeprefix("pairs/").split("-")[0]
        for name, values in (
            ("split", pa.array([split] * table.num_rows, pa.string())),
            (SHARD, pa.array([record.name] * table.num_rows, pa.string())),
            (ROW, pa.array(range(table.num_rows), pa.int64())),
        ):
            table = table.append_column(name, values)
        tables.append(table)
    return pa.concat_tables(tables)
