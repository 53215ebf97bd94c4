from __future__ import annotations

import cv2
import numpy as np
import pytest

from rendezvous.evaluation.dataset.card import histogram
from rendezvous.evaluation.pictures.canvas import BLUE, RED, SHEET_WIDTH_PX, encoded_png
from rendezvous.evaluation.pictures.map_panels import BOTH
from rendezvous.evaluation.pictures.pairs import contact_sheet
from rendezvous.evaluation.pictures.plans import plan_sheet
from rendezvous.evaluation.pictures.poses import labelled_image
from rendezvous.floorplan.records import Floorplan, Room, Shape, Solid
from rendezvous.geometry.se2 import SE2
from tests.synthetic import synthetic_row, synthetic_view

OVERLAY = slice(920, SHEET_WIDTH_PX)


@pytest.fixture(scope="module")
def row():
    return synthetic_row(np.random.default_rng(1), plan=1)


def _count(image, colour) -> int:
    return int((image == np.array(colour, np.uint8)).all(axis=2).sum())


def _wall_px(row) -> tuple[int, int]:
    """Pixels of walls that only one map has, and of walls that both have, in the overlay."""
    image = contact_sheet([row], title="", subtitle="")[200:, OVERLAY]
    return _count(image, RED) + _count(image, BLUE), _count(image, BOTH)


def test_walls_coincide_in_the_overlay_only_when_rightly_aligned(row):
    _, both_px = _wall_px(row)
    wrong = row | {"T_m0_m1_local": SE2(0.3, 0.3, 0.0) @ row["T_m0_m1_local"]}
    assert both_px > 3 * _wall_px(wrong)[1]


def test_the_overlay_is_drawn_in_the_plans_axes(row):
    """Half a turn of robot 0's map frame changes neither the building nor the scale of the line."""
    turn = SE2(0.0, 0.0, np.pi)
    moved = {name: turn @ row[name] for name in ("origin_0", "T_m0_r0", "T_m0_m1", "T_m0_m1_local")}
    for name in ("trajectory_0", "trajectory_0_true"):
        moved[name] = row[name].copy()
        moved[name][:, 1:3] = turn @ row[name][:, 1:3]
    moved["T_w_m0"] = row["T_w_m0"] @ turn.inverse()
    before, after = (contact_sheet([r], title="")[200:, OVERLAY] for r in (row, row | moved))
    assert before.shape == after.shape
    assert np.mean(np.abs(before.astype(int) - after.astype(int)) > 60) < 0.005


def test_a_sheet_has_a_strip_for_every_row(row):
    one, two = (contact_sheet([row] * n, title="Rendezvous", subtitle="test") for n in (1, 2))
    assert one.shape[1:] == two.shape[1:] == (SHEET_WIDTH_PX, 3)
    header_and_foot_px = 2 * one.shape[0] - two.shape[0]
    assert np.array_equal(one[header_and_foot_px - 28 :], two[one.shape[0] - 28 :])


def test_what_robot_0_sees_stands_beside_the_maps_whether_or_not_all_have_an_image(row):
    seen = row | synthetic_view(row)
    alone, mixed = contact_sheet([seen], title=""), contact_sheet([row, seen], title="")
    view, top_px = labelled_image(seen, width_px=340), 148 + 32 + 62
    assert np.array_equal(alone[top_px : top_px + view.shape[0], 28 : 28 + 340], view)
    assert _count(alone[top_px:, 28 + 340 :], BOTH) > 50
    strip_px = (alone.shape[0] - 28) - (148 + 32)
    assert np.array_equal(mixed[-strip_px - 28 :], alone[-strip_px - 28 :])
    assert (mixed[top_px + 30 : -strip_px - 28, 28 : 28 + 340] == 255).all()


def test_a_sheet_without_images_or_common_walls_is_laid_out_for_maps_alone(row):
    columns = dict.fromkeys(("image", "T_c_o", "projected_cuboid_px", "visibility", "box_px"))
    lone = row | {"wall_agreement_local": None}
    assert np.array_equal(contact_sheet([lone | columns], title=""), contact_sheet([lone], title=""))


def test_a_photograph_is_encoded_without_loss_and_filtered():
    noise = np.random.default_rng(0).integers(-2, 3, (200, 300, 1))
    ramp = (np.arange(300) // 2)[None, :, None] + np.zeros((200, 1, 3), int)
    image = (ramp + noise + 20).astype(np.uint8)
    png = encoded_png(image)
    assert np.array_equal(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)[..., ::-1], image)
    unfiltered = [cv2.IMWRITE_PNG_COMPRESSION, 9, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE]
    assert len(png) < 0.85 * len(cv2.imencode(".png", image[..., ::-1], unfiltered)[1])


def test_bars_are_as_high_as_their_counts():
    edges = np.linspace(0.0, 1.0, 5)
    chart = histogram(np.array([0.1] * 10 + [0.6] * 5), edges, title="", mark=0.3, mark_label="")
    heights = (chart == np.array(BLUE, np.uint8)).all(axis=2).sum(axis=0)
    first, second, third, _ = (heights[28 + i * 296 + 148] for i in range(4))
    assert second == 0
    assert first == pytest.approx(2 * third, abs=4)


def test_plans_are_drawn_with_holes_furniture_and_names():
    square = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 6.0], [0.0, 6.0]])
    plan = Floorplan(
        plan_id="a plan with a name that is too long to fit",
        outline_m=square,
        holes_m=(square[::-1] / 4 + 2.0,),
        rooms=(Room(category="Living_Room", box_m=(4.5, 0.0, 8.0, 6.0)),),
    )
    table = Solid(
        shape=Shape.CYLINDER, x_m=1.0, y_m=4.0, yaw_rad=0.0, half_x_m=0.5, half_y_m=0.5, z0_m=0.0, z1_m=0.7,
        category="table", item=0,
    )  # fmt: skip
    bare, furnished = (plan_sheet([(plan, solids)], title="Plans") for solids in ((), (table,)))
    wood = _count(furnished, (214, 188, 150))
    assert _count(bare, (214, 188, 150)) == 0
    px_per_m = min(390 / 8, 300 / 6)
    assert wood == pytest.approx(np.pi * (0.5 * px_per_m) ** 2, rel=0.15)
    assert furnished.shape == plan_sheet([(plan, ())] * 4, title="Plans").shape
