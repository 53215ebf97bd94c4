"""Shares and ranges from which training images are drawn."""

from __future__ import annotations

from dataclasses import dataclass, fields

from rendezvous.errors import ConfigError, require_within


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotDraws:
    """How far a robot may differ from its model; one is drawn for each episode and each training image."""

    as_built_share: float = 0.2
    plate_shift_m: float = 0.004
    least_plate_thickness: float = 0.35
    """Half of all robots have thinner plates, down to this share of the model's."""
    post_shift_m: float = 0.003
    part_shift_m: float = 0.006
    part_scale: float = 0.15
    """Largest change of a part's sides, as a logarithm."""
    turned_layer_share: float = 0.1
    """Share of layers whose boards are turned by quarters."""
    missing_share: float = 0.15
    no_cable_share: float = 0.4
    other_model_share: float = 0.35
    """Share of robots with another lidar or camera than the first."""
    no_camera_share: float = 0.2
    moved_camera_share: float = 0.25
    repainted_share: float = 0.35
    dirty_share: float = 0.3
    added_plate_share: float = 0.1
    added_box_share: float = 0.12
    added_mast_share: float = 0.08
    sticker_share: float = 0.15

    def __post_init__(self) -> None:
        shares = {f.name: (0.0, 1.0) for f in fields(self) if f.name.endswith("_share")}
        require_within(self, **shares, least_plate_thickness=(0.1, 1.0), part_scale=(0.0, 0.5))
        require_within(self, plate_shift_m=(0.0, 0.02), post_shift_m=(0.0, 0.02), part_shift_m=(0.0, 0.03))
        if self.no_camera_share + self.moved_camera_share > 1.0:
            raise ConfigError(
                f"RobotDraws: no_camera_share is {self.no_camera_share} and moved_camera_share "
                f"{self.moved_camera_share}; must be at most 1 together"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseDraws:
    """How training images are drawn."""

    plausible_share: float = 0.5  # share on the floor of a furnished room; others are fully randomised
    absent_share: float = 0.1  # share of images without the robot
    occluded_share: float = 0.35  # share of images with an object placed in front of the robot
    look_alike_share: float = 0.0  # share of things drawn among those that look like the robot alone
    shadow_share: float = 0.25  # share of images with a lamp that casts shadows
    # photo_share: of `free` images, taken as people take pictures: from above, before white or busy
    # backgrounds, with other focal lengths and image sizes, some too near for the frame.
    photo_share: float = 0.35
    # min_range_m, max_range_m: distance from the camera to the centre of the robot's cuboid.
    min_range_m: float = 0.3
    max_range_m: float = 4.0
    robot: RobotDraws = RobotDraws()

    def __post_init__(self) -> None:
        share = (0.0, 1.0)
        require_within(
            self,
            plausible_share=share,
            absent_share=share,
            occluded_share=share,
            look_alike_share=share,
            shadow_share=share,
            photo_share=share,
        )
        require_within(self, min_range_m=(0.05, 20.0), max_range_m=(0.05, 20.0))
        if self.min_range_m >= self.max_range_m:
            raise ConfigError(
                f"PoseDraws: min_range_m is {self.min_range_m} and max_range_m {self.max_range_m}; "
                "the first must be smaller"
            )
