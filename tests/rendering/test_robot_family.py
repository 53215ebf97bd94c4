"""The robot's family: variants stay robots, differ as far as drawn, and say what was drawn."""

import json
from dataclasses import replace

import numpy as np
import pytest

from rendezvous.errors import ConfigError
from rendezvous.rendering.draws import RobotDraws
from rendezvous.rendering.robot_family import FIXED, robot_looks
from rendezvous.rendering.robot_model import nominal_parts, robot_parts
from rendezvous.robot_file import load_robot, load_robot_model

BURGER = load_robot("burger")
LOOKS, MESHES = robot_looks(BURGER, robot_parts(load_robot_model("burger"), source="burger"))
NEVER = RobotDraws(
    as_built_share=0.0, plate_shift_m=0.0, least_plate_thickness=1.0, post_shift_m=0.0, part_shift_m=0.0,
    part_scale=0.0, turned_layer_share=0.0, missing_share=0.0, no_cable_share=0.0, other_model_share=0.0,
    no_camera_share=0.0, moved_camera_share=0.0, repainted_share=0.0, dirty_share=0.0, added_plate_share=0.0,
    added_box_share=0.0, added_mast_share=0.0, sticker_share=0.0,
)  # fmt: skip


def drawn(draws, count=40, wear=0.0):
    return [LOOKS.draw(np.random.default_rng(i), draws, wear=wear, variants=2) for i in range(count)]


def heights_m(variant, name):
    """Lowest and highest coordinate of a part of a variant."""
    T_r, bounds_m = variant.parts[name].T_r, LOOKS.parts[name].bounds_m
    return T_r[2, 2] * bounds_m[:, 2] + T_r[2, 3]


def test_a_robot_as_built_has_one_lidar_and_every_part_where_it_is():
    variant = LOOKS.as_built()
    assert {name.split(".")[1] for name in variant.parts if name.startswith("lidar")} == {"lds01"}
    assert set(variant.parts) == set(nominal_parts(LOOKS.parts)) < set(LOOKS.parts)
    assert all(np.array_equal(part.T_r, np.eye(4)) for part in variant.parts.values())
    assert variant.parts["battery"].material == LOOKS.parts["battery"].material


def test_the_share_of_robots_as_built_is_the_given_one():
    shares = [
        sum("as_built" in v.record for v in drawn(replace(NEVER, as_built_share=s))) for s in (0.0, 1.0)
    ]
    assert shares == [0, 40]
    assert 8 <= sum("as_built" in v.record for v in drawn(replace(NEVER, as_built_share=0.5))) <= 32


def test_without_anything_drawn_only_the_lidars_head_turns_and_cables_hang_otherwise():
    built = LOOKS.as_built()
    for variant in drawn(NEVER, 5):
        assert set(variant.parts) == set(built.parts)
        moved = {n for n, p in variant.parts.items() if not np.allclose(p.T_r, np.eye(4), atol=1e-6)}
        assert {n.split(".")[0] for n in moved} == {"cable", "lidar"}
        assert {n for n in moved if n.startswith("lidar")} == {"lidar.lds01.head"}
        assert all(p.material == built.parts[n].material for n, p in variant.parts.items())


def test_plates_shift_and_thin_and_posts_reach_from_one_to_the_next():
    draws = replace(NEVER, plate_shift_m=0.004, least_plate_thickness=0.4)
    variants = drawn(draws)
    thick_m = np.array([np.ptp(heights_m(v, "plate.2")) for v in variants])
    assert 0.2 < (thick_m < 0.0089).mean() < 0.8
    assert 0.4 * 0.009 - 1e-9 <= thick_m.min() < 0.005
    shifts_m = np.array([heights_m(v, "plate.2")[0] - 0.095 for v in variants])
    assert np.abs(shifts_m).max() <= 0.004 + 1e-9
    assert np.ptp(shifts_m) > 0.005
    for variant in variants:
        low_m, high_m = heights_m(variant, "post.1.side_left")
        assert heights_m(variant, "plate.1")[0] < low_m < heights_m(variant, "plate.1")[1] + 1e-9
        assert heights_m(variant, "plate.2")[0] - 1e-9 < high_m < heights_m(variant, "plate.2")[1]


def test_what_stands_on_a_plate_goes_with_it_and_wheels_stay_on_the_floor():
    for variant in drawn(replace(NEVER, plate_shift_m=0.004, least_plate_thickness=0.4)):
        rise_m = heights_m(variant, "board.pi")[0] - LOOKS.parts["board.pi"].bounds_m[0, 2]
        assert rise_m == pytest.approx(heights_m(variant, "plate.2")[1] - 0.104, abs=1e-6)
        assert heights_m(variant, "battery")[0] == pytest.approx(0.019)
        for name in variant.parts:
            if name.split(".")[0] in FIXED:
                assert np.array_equal(variant.parts[name].T_r, np.eye(4))


def test_a_layers_boards_and_plugs_are_shifted_and_turned_together():
    draws = replace(NEVER, part_shift_m=0.006, turned_layer_share=1.0)
    turns = []
    for variant in drawn(draws, 20):
        board, plug = variant.parts["board.pi"].T_r, variant.parts["plug.usb"].T_r
        assert np.allclose(board, plug)
        turns.append(round(float(np.degrees(np.arctan2(board[1, 0], board[0, 0])))) % 360)
    assert set(turns) == {90, 180, 270}


@pytest.mark.parametrize(
    ("share", "has"),
    [
        ("no_camera_share", lambda v: not any(n.startswith("camera") for n in v.parts)),
        ("other_model_share", lambda v: "lidar.lds02.head" in v.parts and "lidar.lds01.head" not in v.parts),
        ("missing_share", lambda v: not any(n.startswith(("plug", "chip", "screw")) for n in v.parts)),
        ("no_cable_share", lambda v: not any(n.startswith("cable") for n in v.parts)),
        ("added_plate_share", lambda v: "added.plate.4" in v.parts),
        ("added_box_share", lambda v: "added.box" in v.parts),
        ("added_mast_share", lambda v: "added.mast.1" in v.parts),
        ("sticker_share", lambda v: "added.sticker.3" in v.parts),
    ],
)
def test_a_share_of_one_gives_it_to_every_robot_and_none_to_no_robot(share, has):
    assert all(has(v) for v in drawn(replace(NEVER, **{share: 1.0}), 8))
    assert not any(has(v) for v in drawn(NEVER, 8))


def test_a_moved_camera_is_elsewhere_and_still_one_camera():
    places = []
    for variant in drawn(replace(NEVER, moved_camera_share=1.0), 20):
        body, face = (variant.parts[f"camera.d435.{part}"].T_r for part in ("body", "face"))
        assert np.allclose(body, face)
        places.append(body[:3, 3])
    assert np.ptp(places, axis=0)[1] > 0.03
    assert len({round(float(z), 3) for _, _, z in places}) == 3


def test_paint_changes_some_kinds_of_a_repainted_robot_and_dirt_lightens_all():
    built = LOOKS.as_built()
    painted = drawn(replace(NEVER, repainted_share=1.0), 20)
    changed = [
        np.mean([v.parts[n].material != built.parts[n].material for n in built.parts]) for v in painted
    ]
    assert 0.2 < np.mean(changed) < 0.8
    assert len({v.parts["plate.0"].material for v in painted}) > 5
    assert all(v.parts["plate.0"].material == v.parts["plate.3"].material for v in painted)
    for variant in drawn(replace(NEVER, dirty_share=1.0), 8):
        plate = variant.parts["plate.0"].material
        assert plate.texture is not None
        assert sum(plate.base_colour_rgb) > sum(built.parts["plate.0"].material.base_colour_rgb)


def test_the_record_is_json_and_the_same_draws_give_the_same_robot():
    first, again = (LOOKS.draw(np.random.default_rng(7), RobotDraws(), wear=1.0, variants=2) for _ in "ab")
    assert json.dumps(first.record) == json.dumps(again.record)
    assert [i.name for i in first.instances(np.eye(4))] == [i.name for i in again.instances(np.eye(4))]
    assert all(
        np.array_equal(a.T_w, b.T_w)
        for a, b in zip(first.instances(np.eye(4)), again.instances(np.eye(4)), strict=True)
    )


def test_parts_stand_at_the_robots_pose():
    T_w_r1 = np.eye(4)
    T_w_r1[:3, 3] = 1.0, 2.0, 3.0
    for instance in LOOKS.as_built().instances(T_w_r1):
        assert instance.T_w[:3, 3].tolist() == [1.0, 2.0, 3.0]
        assert instance.mesh in MESHES


def test_shares_of_cameras_must_leave_room_for_the_rest():
    with pytest.raises(ConfigError, match="must be at most 1 together"):
        RobotDraws(no_camera_share=0.7, moved_camera_share=0.4)
    with pytest.raises(ConfigError, match="dirty_share"):
        RobotDraws(dirty_share=1.2)
