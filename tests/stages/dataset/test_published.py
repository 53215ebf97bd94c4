from __future__ import annotations

from pathlib import Path

import pytest

from rendezvous.evaluation.dataset.sampling import located_columns
from rendezvous.schema import EXPLORE, PAIRS, SIGHTINGS, VIEWS
from rendezvous.stages.dataset.published import PackedPlan, pairs_at, pairs_file, with_views
from rendezvous.store.tables import content_digest, item_digests
from tests.synthetic_dataset import ROWS, VIEW_ROWS, explored, synthetic_run

SIGHTED = EXPLORE.table([row for rows in ROWS[:3] for row in rows]).select([c.name for c in SIGHTINGS])
SEEN = [row for rows in VIEW_ROWS[:3] for row in rows]


def test_a_view_joins_its_sighting_whatever_their_order():
    for order in (range(6), (5, 0, 3, 1, 4, 2)):
        pairs = PAIRS.rows(with_views(SIGHTED, VIEWS.table([SEEN[i] for i in order])))
        assert [pair["image"] for pair in pairs] == [view["image"] for view in SEEN]
        assert [pair["pair_id"] for pair in pairs] == SIGHTED["pair_id"].to_pylist()


def test_a_sighting_without_a_view_keeps_its_row():
    table = with_views(SIGHTED, VIEWS.table(SEEN[1:2]))
    assert table.schema.equals(PAIRS.arrow(), check_metadata=True)
    for i, pair in enumerate(PAIRS.rows(table)):
        given = SEEN[1] if i == 1 else {}
        assert pair["image"] == given.get("image")
        assert pair["visibility"] == given.get("visibility")
        assert (pair["T_c_o"] is None) == (i != 1)
        assert pair["map_0"] == ROWS[i // 2][i % 2]["map_0"]


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    explored(folder)
    return folder


def test_items_of_a_file_have_the_digests_of_their_own_rows(data):
    """Of slices of nested lists, pyarrow 26 takes the wrong values; so a file's table must have none."""
    explore, render = synthetic_run(data).read("explore"), synthetic_run(data).read("render")
    views = {item.item_id: item for item in render.items("views/")}
    plans = [
        PackedPlan(item=item, view=views[item.item_id], rows=2, split="train")
        for item in list(explore.items())[1:4]
    ]
    table = pairs_file(explore, render, plans).table
    alone = {plan.item.item_id: pairs_file(explore, render, [plan]).table for plan in plans}
    assert item_digests(table, "plan_id") == {name: content_digest(rows) for name, rows in alone.items()}


@pytest.mark.parametrize("seen", [True, False])
def test_pairs_picked_out_are_those_that_are_published(seen, data):
    explore, render = synthetic_run(data).read("explore"), synthetic_run(data).read("render")
    views = located_columns(render, ["pair_id"], under="views/") if seen else None
    places = located_columns(explore, ["pair_id"]).take([17, 0, 5])
    picked = pairs_at(explore, render, sightings=places, views=views)
    for row, place in zip(picked, (17, 0, 5), strict=True):
        assert row["pair_id"] == ROWS[place // 2][place % 2]["pair_id"]
        assert row["image"] == (VIEW_ROWS[place // 2][place % 2]["image"] if seen else None)
        assert {column.name for column in PAIRS.columns} <= row.keys()
