"""The interface of every estimator of the frame error, learned or not, and the one that corrects nothing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Protocol

from rendezvous.alignment.window import MapWindow
from rendezvous.geometry.se2 import SE2, Array

WRONG_M, WRONG_RAD = 0.5, math.radians(5.0)  # an error above either would spoil the fused map


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """An estimated frame error, or the reason there is none.

    Attributes:
        theta: the frame error θ̂ in the window frame v, or None. Map 1 as placed is θ̂ applied to map 1 as it
            should lie.
        covariance: (3, 3) of the components x [m], y [m], yaw [rad] of θ̂⁻¹ θ; None if the method gives none.
        degrees_of_freedom: of the Student's t distribution with this covariance, more than 2; infinite for
            normal errors.
        ambiguous: another, distinct θ explains the maps about as well.
        reason: why theta is None; '' otherwise.
    """

    theta: SE2 | None
    covariance: Array | None = None
    degrees_of_freedom: float = math.inf
    ambiguous: bool = False
    reason: str = ""

    def __post_init__(self) -> None:
        assert (self.theta is None) == bool(self.reason), "an estimate has either a theta or a reason"
        assert self.covariance is None or self.covariance.shape == (3, 3)
        assert self.degrees_of_freedom > 2.0, self.degrees_of_freedom


class FrameErrorEstimator(Protocol):
    """A method that finds the frame error in a window."""

    @property
    def name(self) -> str:
        """The method's name in tables."""

    def __call__(self, window: MapWindow) -> Estimate:
        """Estimate the frame error in a window."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """Leaves the estimate from the rendezvous as it is (Eq. 2 without Eq. 3)."""

    name: ClassVar[str] = "identity"

    def __call__(self, window: MapWindow) -> Estimate:
        """θ̂ = identity for any window."""
        return Estimate(theta=SE2.identity())
