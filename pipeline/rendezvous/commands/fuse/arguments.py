"""Checks of the arguments of `fuse` without heavy imports; the command line makes them first."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal, get_args

from rendezvous.errors import ConfigError

Refine = Literal["none", "learned", "correlative", "auto"]
Merge = Literal["occupied", "probabilistic"]
REFINEMENTS, MERGINGS = get_args(Refine), get_args(Merge)

LARGEST_SIGMA = 1000.0  # a pose with a larger standard deviation [m, m, rad] is not known at all

AS_IN_PYTHON: Callable[[str], str] = str  # spells an argument's name in messages


def require_one_sighting(
    *,
    image: bool,
    camera: bool,
    camera_pose: bool,
    relative: bool,
    relative_sigma: bool,
    spelt: Callable[[str], str] = AS_IN_PYTHON,
) -> None:
    """Check that there are either images and their camera or a relative pose.

    Args:
        image, camera, camera_pose, relative, relative_sigma: whether each is given.
        spelt: spells an argument's name in messages.

    Raises:
        ConfigError: something is missing or contradicts the rest.
    """
    if image and relative:
        raise ConfigError(
            f"{spelt('image')} and {spelt('relative')}: give one of them and not both; either says where "
            "robot 1 stood"
        )
    if not image and not relative:
        raise ConfigError(
            f"fuse: give {spelt('image')} with {spelt('camera')}, or {spelt('relative')}: where did robot 0 "
            "see robot 1?"
        )
    if image and not camera:
        raise ConfigError(
            f"{spelt('image')}: {spelt('camera')} is missing; an image needs the camera that took it, as its "
            "camera_info YAML"
        )
    if image and relative_sigma:
        raise ConfigError(
            f"{spelt('relative_sigma')}: belongs to {spelt('relative')}; an image gives its own error"
        )
    for name, given in (("camera", camera), ("camera_pose", camera_pose)):
        if relative and given:
            raise ConfigError(
                f"{spelt(name)}: belongs to {spelt('image')}; {spelt('relative')} needs no camera"
            )


def require_sigma(name: str, sigma: tuple[float, ...]) -> None:
    """Check standard deviations.

    Raises:
        ConfigError: one is 0 or below, or too large to mean anything.
    """
    if not all(0.0 < value <= LARGEST_SIGMA for value in sigma):
        raise ConfigError(
            f"{name} is {sigma}; must be standard deviations above 0, at most {LARGEST_SIGMA:g}"
        )


def require_one_of(name: str, given: object, choices: tuple[str, ...]) -> None:
    """Check a choice.

    Raises:
        ConfigError: there is no such choice; names those there are.
    """
    if given not in choices:
        raise ConfigError(f"{name} is {given!r}; must be one of {', '.join(choices)}")


def numbers(name: str, given: str, shape: str) -> tuple[float, ...]:
    """Numbers with commas between them, as many as the shape names: "x,y,yaw".

    Raises:
        ConfigError: there are more, fewer, or some that are not finite.
    """
    try:
        values = tuple(float(word) for word in given.split(","))
    except ValueError:
        values = ()
    count = shape.count(",") + 1
    if len(values) != count or not all(map(math.isfinite, values)):
        raise ConfigError(f"{name} is {given!r}; must be {shape}: {count} finite numbers")
    return values
