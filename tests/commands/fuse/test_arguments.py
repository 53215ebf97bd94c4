"""Checks of the arguments of `fuse`, as the command line and Python share them."""

import math

import pytest

from rendezvous.commands.fuse.arguments import (
    LARGEST_SIGMA,
    numbers,
    require_one_of,
    require_one_sighting,
    require_sigma,
)
from rendezvous.errors import ConfigError

NAMES = ("image", "camera", "camera_pose", "relative", "relative_sigma")


def accepted(*names: str) -> bool:
    try:
        require_one_sighting(**{name: name in names for name in NAMES})
    except ConfigError:
        return False
    return True


def test_there_are_images_with_their_camera_or_a_relative_pose():
    every = [
        {name for bit, name in enumerate(NAMES) if number >> bit & 1} for number in range(2 ** len(NAMES))
    ]
    right = [names for names in every if accepted(*names)]
    assert right == [
        {"image", "camera"},
        {"image", "camera", "camera_pose"},
        {"relative"},
        {"relative", "relative_sigma"},
    ]


def test_a_message_spells_the_names_as_it_is_told():
    given = dict.fromkeys(NAMES, False) | {"relative": True, "camera_pose": True}
    with pytest.raises(ConfigError, match="camera_pose: belongs to image; relative needs no camera"):
        require_one_sighting(**given)
    with pytest.raises(ConfigError, match="--camera-pose: belongs to --image; --relative needs no camera"):
        require_one_sighting(**given, spelt=lambda name: f"--{name.replace('_', '-')}")


def test_standard_deviations_are_above_0_and_known():
    require_sigma("sigma", ())
    require_sigma("sigma", (1e-9, 1.0, LARGEST_SIGMA))
    for wrong in (0.0, -1.0, 1.001 * LARGEST_SIGMA, math.nan):
        for place in range(3):
            sigma = [0.1, 0.1, 0.1]
            sigma[place] = wrong
            with pytest.raises(ConfigError, match=r"sigma is \(.*\); must be standard deviations above 0"):
                require_sigma("sigma", tuple(sigma))


def test_numbers_are_as_many_as_the_shape_names():
    assert numbers("--pose", "1,-2.5,3e-1", "x,y,yaw") == (1.0, -2.5, 0.3)
    for wrong in ("1,2", "1,2,3,4", "1,2,", "1,2,nan", "1,2,inf", "a,b,c", ""):
        with pytest.raises(ConfigError, match=r"--pose is '.*'; must be x,y,yaw: 3 finite numbers"):
            numbers("--pose", wrong, "x,y,yaw")


def test_a_choice_is_one_of_those_there_are():
    require_one_of("merge", "occupied", ("occupied", "probabilistic"))
    with pytest.raises(ConfigError, match="merge is 'Occupied'; must be one of occupied, probabilistic"):
        require_one_of("merge", "Occupied", ("occupied", "probabilistic"))
