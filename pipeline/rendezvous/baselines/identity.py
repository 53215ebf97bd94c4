"""No correction: the baseline that every other method must beat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from rendezvous.alignment.estimate import Estimate
from rendezvous.alignment.window import MapWindow
from rendezvous.geometry.se2 import SE2


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """Leaves the estimate from the rendezvous as it is (Eq. 2 without Eq. 3)."""

    name: ClassVar[str] = "identity"

    def __call__(self, window: MapWindow) -> Estimate:
        """θ̂ = identity for any window."""
        return Estimate(theta=SE2.identity())
