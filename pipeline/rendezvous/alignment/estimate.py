"""What every estimator of the frame error takes and gives, learned or not."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from rendezvous.alignment.window import MapWindow
from rendezvous.geometry.se2 import SE2, Array

WRONG_M, WRONG_RAD = 0.5, math.radians(5.0)
"""An estimate farther from the truth than either would spoil the fused map."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """An estimated frame error, or why there is none.

    Attributes:
        theta: the frame error θ̂ in the window frame w: map 1 as placed is θ̂ applied to map 1 as it should
            lie. None if the method found none.
        covariance: (3, 3) of the components x [m], y [m], yaw [rad] of θ̂⁻¹ θ; None from a method that
            cannot tell.
        degrees_of_freedom: of the Student's t distribution that has this covariance, more than 2; infinite:
            the errors are normal.
        ambiguous: another, distinct θ explains the maps about as well.
        reason: why there is no theta; empty if there is one.
    """

    theta: SE2 | None
    covariance: Array | None = None
    degrees_of_freedom: float = math.inf
    ambiguous: bool = False
    reason: str = ""

    def __post_init__(self) -> None:
        assert (self.theta is None) == bool(self.reason), "an estimate has a theta or else a reason"
        assert self.covariance is None or self.covariance.shape == (3, 3)
        assert self.degrees_of_freedom > 2.0, self.degrees_of_freedom


class FrameErrorEstimator(Protocol):
    """A method that finds the frame error in a window."""

    @property
    def name(self) -> str:
        """What tables call it."""

    def __call__(self, window: MapWindow) -> Estimate:
        """The frame error that the window shows."""
