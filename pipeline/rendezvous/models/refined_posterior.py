"""A posterior of the frame error that is fine around its peaks and coarse elsewhere."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from rendezvous.geometry.se2 import SE2, Array
from rendezvous.models.posterior import WHOLE, Gaussian, Posterior, log_sum_exp

COARSE_SHARE = 0.01
"""A close look ends somewhere, a truth may lie beyond: this much of the density is the coarse posterior's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RefinedPosterior:
    """A mixture of close looks at the peaks of a coarse posterior, and of what is left of it.

    Attributes:
        coarse: over the whole search.
        pieces: around each peak, normalised each, the most probable first.
        masses: (K,) their probabilities.
        rest: the coarse posterior away from all peaks; its sum and the masses' make 1.
    """

    coarse: Posterior
    pieces: tuple[Posterior, ...]
    masses: Array
    rest: Posterior

    def sharpened(self, sharpness: float) -> RefinedPosterior:
        """Each piece's density to this power, and normalised again; its mass stays."""
        pieces = (replace(p, log_p_HYX=sharpness * p.log_p_HYX).normalised() for p in self.pieces)
        return replace(self, pieces=tuple(pieces))

    def best(self) -> Gaussian:
        """Mean and covariance of the most probable piece."""
        piece = self.pieces[0]
        return piece.mean_and_covariance(piece.modes(1)[0], box=WHOLE)

    def log_density(self, theta: SE2) -> float:
        """Log of the probability density at θ [1 / (m² rad)]; it integrates to 1."""
        with np.errstate(divide="ignore"):
            logs = np.log(self.masses) + np.array([piece.log_density(theta) for piece in self.pieces])
        fine = log_sum_exp(np.append(logs, self.rest.log_density(theta)))
        shares = math.log1p(-COARSE_SHARE), math.log(COARSE_SHARE)
        return float(np.logaddexp(shares[0] + fine, shares[1] + self.coarse.log_density(theta)))
