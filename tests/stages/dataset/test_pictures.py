from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from rendezvous.stages.dataset import pictures
from tests.synthetic_dataset import VIEW_ROWS

VIEW = {key: value for key, value in VIEW_ROWS[0][0].items() if key not in ("pair_id", "plan_id")}


def test_each_view_is_of_its_observers_furniture_which_is_prepared_once_in_a_row(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    here, there = [{"item": 0}], [{"item": 1}]
    sightings = [
        {"pair_id": f"p{i}", "plan_id": "plan", "episode_id": episode_id, "furniture": list(furniture)}
        for i, (episode_id, furniture) in enumerate(
            [("e0", here), ("e0", here), ("e0", there), ("e0", here), ("e1", here)]
        )
    ]
    prepared: list[Any] = []
    drawn: dict[str, Any] = {}

    def rooms(job: Any, walls: Any, furniture: Any, episode_id: str) -> Any:
        prepared.append((episode_id, furniture))
        return furniture

    monkeypatch.setattr(pictures, "_rooms", rooms)
    monkeypatch.setattr(pictures, "_drawn_view", lambda job, made, row: drawn.update({row["pair_id"]: made}))
    monkeypatch.setattr(pictures, "_image_row", lambda *_: VIEW)
    meshes = SimpleNamespace(rows=lambda *_, **__: [{"plan_id": "plan"}])
    shard = pictures.views(
        None,  # type: ignore[arg-type]
        meshes,  # type: ignore[arg-type]
        (),
        SimpleNamespace(rows=lambda *_, **__: iter(sightings)),  # type: ignore[arg-type]
        (),
    )
    assert shard.counts["views"] == 5
    assert drawn == {row["pair_id"]: row["furniture"] for row in sightings}
    assert prepared == [("e0", here), ("e0", there), ("e0", here), ("e1", here)]
