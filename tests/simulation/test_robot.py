from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pytest import approx

from rendezvous.errors import ConfigError
from rendezvous.robot_file import LIDARS, ROBOTS, load_lidar, load_robot
from rendezvous.simulation.robot import beam_bearings
from tests.simulation.scenes import burger


def test_the_burger_has_its_published_size_and_limits() -> None:
    spec = burger()
    assert spec.size_m == (0.138, 0.178, 0.192)
    assert (spec.wheels.radius_m, spec.wheels.track_m) == (0.033, 0.160)
    assert (spec.max_speed_mps, spec.max_turn_rate_radps) == (0.22, 2.84)
    assert (spec.lidar.beams, spec.lidar.rate_hz, spec.lidar.range_max_m) == (360, 5.0, 3.5)


def test_the_burgers_body_lies_inside_its_cuboid() -> None:
    spec = burger()
    (length, width, height), (x, _, z) = spec.cuboid.size_m, spec.cuboid.centre_m
    assert spec.chassis.centre_x_m - spec.chassis.radius_m >= x - length / 2 - 1e-9
    assert spec.chassis.centre_x_m + spec.chassis.radius_m <= x + length / 2 + 1e-9
    assert spec.wheels.track_m / 2 + spec.wheels.width_m / 2 <= width / 2 + 1e-9
    assert (z - height / 2, z + height / 2) == (approx(0.0), approx(spec.size_m[2]))


def test_a_level_scan_sees_the_cap_above_the_chassis_and_the_chassis_below_it() -> None:
    spec = burger()
    assert spec.circle_at(spec.lidar.z_m) == (spec.lidar.x_m, spec.lidar.cap_radius_m)
    assert spec.circle_at(0.1) == (spec.chassis.centre_x_m, spec.chassis.radius_m)
    body = (spec.chassis.centre_x_m, spec.chassis.radius_m)
    assert spec.circle_at(spec.chassis.top_z_m) == spec.circle_at(spec.chassis.bottom_z_m) == body
    assert spec.circle_at(spec.size_m[2]) == (spec.lidar.x_m, spec.lidar.cap_radius_m)
    assert spec.circle_at(0.3) is None
    assert spec.circle_at(0.005) is None


@pytest.mark.parametrize(
    ("part", "change", "message"),
    [
        ("wheels", {"radius_m": 0.0}, r"wheels\.radius_m is 0\.0; must be positive"),
        ("lidar", {"z_m": 0.5}, r"lidar\.z_m is 0\.5; must be within the robot's 0\.192 m"),
        ("lidar", {"beams": 0}, "lidar with 0 beams"),
        ("lidar", {"beams": 7}, "at least 8 beams"),
        ("lidar", {"beams": 10**15}, r"beams is 1000000000000000; must be from 0 to 100000"),
        ("camera", {"width_px": 10**15}, r"width_px is 1000000000000000; must be from 1 to 20000"),
        ("lidar", {"range_min_m": 3.5}, r"from 3\.5 to 3\.5 m"),
        ("lidar", {"range_min_m": -0.1}, r"from -0\.1 to 3\.5 m"),
        ("lidar", {"turn_hz": 4.0}, r"turn_hz is 4\.0; must be at least lidar\.rate_hz, 5\.0"),
        ("lidar", {"field_of_view_rad": 0.0}, r"field_of_view_rad is 0\.0; must be from 0\.1 to 6\.28"),
        ("lidar", {"rate_hz": 7.0}, r"must divide the controller's 20 Hz, such as 5 or 10"),
        ("chassis", {"top_z_m": 0.4}, "at most the robot's height"),
        ("chassis", {"centre_x_m": 0.0}, r"between the wheels at 0 and the caster at -0\.081 m"),
        ("caster", {"x_m": 0.08}, r"chassis\.centre_x_m is -0\.032; must be between .* caster at 0\.08 m"),
        ("wheels", {"mass_kg": 0.6}, "two wheels of 0.6 kg are not part of 1.0 kg"),
    ],
)
def test_a_robot_that_cannot_be_is_refused(part: str, change: dict[str, Any], message: str) -> None:
    spec = burger()
    with pytest.raises(ConfigError, match=message):
        replace(spec, **{part: replace(getattr(spec, part), **change)})


def test_an_unknown_robot_is_told_with_those_there_are() -> None:
    with pytest.raises(ConfigError, match=r"no file .*; known robots are burger"):
        load_robot("burgr")


@pytest.mark.parametrize("content", [b"", b"\xff\x00", b"- 1"])
def test_a_file_that_holds_no_robot_is_told_with_what_one_is(tmp_path: Any, content: bytes) -> None:
    path = tmp_path / "robot.yaml"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"; must be a robot file, a YAML mapping such as .*burger"):
        load_robot(str(path))


def test_a_misspelt_key_is_told_with_the_one_that_is_meant(tmp_path: Any) -> None:
    text = (ROBOTS / "burger" / "robot.yaml").read_text().replace("track_m:", "trackm:")
    path = tmp_path / "robot.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"robot\.yaml: unknown key .*trackm.*track_m"):
        load_robot(str(path))


@pytest.mark.parametrize("robot", ["x" * 5000, "x" * 5000 + ".yaml", "a\0b.yaml", "/dev/zero.yaml"])
def test_a_name_that_no_file_has_is_told_in_one_short_line(robot: str):
    with pytest.raises(ConfigError, match=r"\Arobot .{1,210}: no file .{1,210}; known robots are burger"):
        load_robot(robot)


def test_the_shipped_lidars_have_the_figures_of_their_data_sheets() -> None:
    # degrees, beams, turns a second, range [m]
    assert {
        path.stem: (round(np.degrees(lidar.field_of_view_rad)), lidar.beams, lidar.turn_hz, lidar.range_max_m)
        for path in LIDARS.glob("*.yaml")
        for lidar in [load_lidar(path.stem)]
    } == {
        "lds-01": (360, 360, 5.0, 3.5),
        "lds-02": (360, 360, 5.0, 8.0),
        "rplidar-a1": (360, 720, 5.0, 12.0),
        "rplidar-a2": (360, 800, 10.0, 12.0),
        "sick-lms": (180, 181, 75.0, 30.0),
        "sick-lms-half-degree": (180, 361, 37.5, 30.0),
        "hokuyo-ust-10lx": (270, 1081, 40.0, 10.0),
        "hokuyo-ust-20lx": (270, 1081, 40.0, 20.0),
    }


def test_a_robot_carries_another_lidar_where_its_own_was() -> None:
    own = burger().lidar
    carried = burger().with_lidar(load_lidar("sick-lms")).lidar
    assert (carried.x_m, carried.z_m, carried.cap_radius_m) == (own.x_m, own.z_m, own.cap_radius_m)
    assert np.degrees(beam_bearings(carried)) == approx(np.arange(-90.0, 91.0))
    assert carried.sweep_s() == approx(0.5 / 75.0)


def test_the_lds_01_is_the_burgers_own() -> None:
    own = burger().lidar
    carried = burger().with_lidar(load_lidar("lds-01")).lidar
    assert replace(carried, turn_hz=None) == own
    assert carried.sweep_s() == own.sweep_s()
    np.testing.assert_array_equal(beam_bearings(carried), beam_bearings(own))


def test_a_robot_with_its_own_lidar_is_to_shards_what_it_always_was() -> None:
    """Other keys would make all shards of earlier versions again."""
    names = burger().parameters()["lidar"].keys()
    assert names == {
        *("x_m", "z_m", "cap_radius_m", "beams", "rate_hz"),
        *("range_min_m", "range_max_m", "no_echo_free_m", "noise"),
    }
    carried = burger().with_lidar(load_lidar("sick-lms")).parameters()["lidar"]
    assert carried.keys() - names == {"field_of_view_rad", "turn_hz", "normals_to_m"}


def test_an_unknown_lidar_is_told_with_those_there_are() -> None:
    with pytest.raises(
        ConfigError, match=r"\Alidar 'sick': no file .*; known lidars are hokuyo.*, sick-lms,"
    ):
        load_lidar("sick")


def test_a_lidar_file_with_a_wrong_key_is_told(tmp_path: Any) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text((LIDARS / "sick-lms.yaml").read_text().replace("beams:", "beam:"))
    with pytest.raises(ConfigError, match=r"mine\.yaml: unknown key .*beam.*beams"):
        load_lidar(str(path))
