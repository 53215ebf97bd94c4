"""Shares and ranges from which training images are drawn."""

from __future__ import annotations

from dataclasses import dataclass

from rendezvous.errors import ConfigError, require_within


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseDraws:
    """How training images are drawn."""

    plausible_share: float = 0.5  # share on the floor of a furnished room; others are fully randomised
    absent_share: float = 0.05  # share of images without the robot
    occluded_share: float = 0.35  # share of images with an object placed in front of the robot
    shadow_share: float = 0.25  # share of images with a lamp that casts shadows
    # min_range_m, max_range_m: distance from the camera to the centre of the robot's cuboid.
    min_range_m: float = 0.3
    max_range_m: float = 4.0

    def __post_init__(self) -> None:
        share = (0.0, 1.0)
        require_within(
            self, plausible_share=share, absent_share=share, occluded_share=share, shadow_share=share
        )
        require_within(self, min_range_m=(0.05, 20.0), max_range_m=(0.05, 20.0))
        if self.min_range_m >= self.max_range_m:
            raise ConfigError(
                f"PoseDraws: min_range_m is {self.min_range_m} and max_range_m {self.max_range_m}; "
                "the first must be smaller"
            )
