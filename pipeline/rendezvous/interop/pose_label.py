"""The label of one image, from which exports in other formats are made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rendezvous.errors import PipelineError
from rendezvous.geometry.camera import PinholeCamera
from rendezvous.geometry.cuboid import Vec3, project_cuboid
from rendezvous.geometry.se2 import Array

Box = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseLabel:
    """Where the robot is in an image and how much of it is visible."""

    camera: PinholeCamera  # the image's intrinsics and size
    cuboid_size_m: Vec3  # sides of the robot's cuboid along the axes of o
    T_c_o: Array | None  # (4, 4) pose of the cuboid in the camera; None without a robot
    visible_px: int  # number of visible pixels of the robot
    silhouette_px: int  # number of pixels it would cover unoccluded, including those outside the image
    box_px: Box | None  # x0, y0, x1, y1 of the outer edges of the visible pixels; None if there are none

    def __post_init__(self) -> None:
        if self.T_c_o is None and self.visible_px > 0:
            raise PipelineError(f"label: {self.visible_px} visible pixels of a robot that has no pose")
        if not 0 <= self.visible_px <= self.silhouette_px:
            raise PipelineError(
                f"label: {self.visible_px} visible of {self.silhouette_px} pixels; "
                "visible are at least none and at most all"
            )
        if (self.box_px is None) != (self.visible_px == 0):
            raise PipelineError(
                f"label: box {self.box_px} around {self.visible_px} pixels; "
                "there is a box exactly where pixels are visible"
            )

    @property
    def visibility(self) -> float:
        """Visible pixels / pixels of the silhouette; 0 if none is visible."""
        return self.visible_px / self.silhouette_px if self.visible_px else 0.0

    def projected_cuboid_px(self) -> Array | None:
        """(9, 2) the cuboid's points in DOPE's order, NaN behind the camera; None without a robot."""
        return None if self.T_c_o is None else project_cuboid(self.T_c_o, self.cuboid_size_m, self.camera)


def label_of(row: Mapping[str, Any]) -> PoseLabel:
    """The label in a row of `poses` or `pairs` (from the schema's `rows`) that has an image.

    Raises:
        PipelineError: the row contradicts itself.
    """
    box_px, visible_px = row["box_px"], row["visible_px"]
    x_m, y_m, z_m = row["cuboid_size_m"].tolist()
    return PoseLabel(
        camera=PinholeCamera.of_matrix(row["K"], row["image_width_px"], row["image_height_px"]),
        cuboid_size_m=(x_m, y_m, z_m),
        T_c_o=row["T_c_o"],
        visible_px=visible_px,
        silhouette_px=row["silhouette_px"],
        box_px=None if box_px is None else tuple(box_px.tolist()),
    )
