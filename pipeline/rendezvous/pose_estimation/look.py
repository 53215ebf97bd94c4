"""A look: the part of an image that the network sees, resampled.

The map from image to network input is a similarity without rotation: input pixel = scale * image pixel +
offset, where (0, 0) is the centre of the first pixel in both. The network's belief maps have cells of
`STRIDE_PX` input pixels; see `dope_labels`.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from rendezvous.geometry.camera import Image
from rendezvous.geometry.se2 import Array

STRIDE_PX = 8  # input pixels along a cell of the belief maps, as in DOPE


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """A rectangle of an image, resampled."""

    scale: float  # input pixels per image pixel
    offset_px: tuple[float, float]  # position of the image's pixel (0, 0) in the input [px]
    # width_px, height_px: size of the input, multiples of STRIDE_PX.
    width_px: int
    height_px: int

    def __post_init__(self) -> None:
        assert self.scale > 0.0, self.scale
        assert self.width_px % STRIDE_PX == 0, self.width_px
        assert self.height_px % STRIDE_PX == 0, self.height_px

    @staticmethod
    def at(centre_px: Array, *, scale: float, width_px: int, height_px: int) -> Look:
        """The look centred on a point of the image."""
        u, v = (float(value) for value in centre_px)
        offset_px = (0.5 * (width_px - 1) - scale * u, 0.5 * (height_px - 1) - scale * v)
        return Look(scale=scale, offset_px=offset_px, width_px=width_px, height_px=height_px)

    def to_input(self, uv_px: Array) -> Array:
        """Points (..., 2) from image to input."""
        return self.scale * uv_px + np.array(self.offset_px)

    def to_image(self, uv_px: Array) -> Array:
        """Points (..., 2) from input to image."""
        return (uv_px - np.array(self.offset_px)) / self.scale

    def cut(self, image: Image) -> Image:
        """(height_px, width_px, 3) uint8: the network's input; black beyond the image's edges.

        To shrink, the image is first averaged down, so that no pixel is skipped.
        """
        scale, offset = self.scale, np.array(self.offset_px)
        if scale < 1.0:
            height, width = image.shape[:2]
            size = max(1, round(width * scale)), max(1, round(height * scale))
            sx, sy = size[0] / width, size[1] / height
            image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
            # Pixel centres move: u = (u_small + 0.5) / sx - 0.5.
            shift = 0.5 * scale * (np.array([1.0 / sx, 1.0 / sy]) - 1.0) + offset
            matrix = np.array([[scale / sx, 0.0, shift[0]], [0.0, scale / sy, shift[1]]])
        else:
            matrix = np.array([[scale, 0.0, offset[0]], [0.0, scale, offset[1]]])
        return np.asarray(
            cv2.warpAffine(image, matrix, (self.width_px, self.height_px), flags=cv2.INTER_LINEAR), np.uint8
        )
