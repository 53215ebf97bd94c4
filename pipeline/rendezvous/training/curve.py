"""Points of "error against training samples", the curve of a training run."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class CurvePoint(ABC):
    """Where training stood once; each kind of model adds what its errors are.

    Attributes:
        samples: seen so far.
        elapsed_s: time in training, validation included.
        training_loss: mean since the last point.
        validation_loss: of the averaged weights.
    """

    samples: int
    elapsed_s: float
    training_loss: float
    validation_loss: float

    def as_dict(self) -> dict[str, float | None]:
        """Values by field; None for one that there is not."""
        return asdict(self)

    @abstractmethod
    def told(self) -> str:
        """In words."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameErrorPoint(CurvePoint):
    """Of a model of the frame error.

    Attributes:
        error_x_m, error_y_m, error_yaw_rad: mean absolute components of θ̂⁻¹ θ on the validation pairs.
    """

    error_x_m: float
    error_y_m: float
    error_yaw_rad: float

    def told(self) -> str:
        """In words."""
        return (
            f"{self.samples} samples: loss {self.training_loss:.4g}, on validation pairs "
            f"{self.validation_loss:.4g}, mean error {self.error_x_m:.3f} m, {self.error_y_m:.3f} m, "
            f"{self.error_yaw_rad:.3f} rad"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class PosePoint(CurvePoint):
    """Of a network of the relative pose; distances in pixels of its input.

    Attributes:
        keypoints_found: share of the keypoints in close looks whose belief map has a peak.
        mean_distance_px, median_distance_px: of those peaks from the keypoints; null if none is found.
        false_peaks: share of looks without the robot that show a centroid nevertheless.
    """

    keypoints_found: float
    mean_distance_px: float | None
    median_distance_px: float | None
    false_peaks: float

    def told(self) -> str:
        """In words."""
        found = f"{100.0 * self.keypoints_found:.1f} % of keypoints found"
        if self.mean_distance_px is not None:
            found += f", off by {self.mean_distance_px:.2f} px, median {self.median_distance_px:.2f} px"
        return (
            f"{self.samples} samples: loss {self.training_loss:.4g}, on validation images "
            f"{self.validation_loss:.4g}; {found}; false centroids {100.0 * self.false_peaks:.1f} %"
        )
