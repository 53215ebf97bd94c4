"""What became of each pair under each method: estimates of the frame error beside the truth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous.alignment.estimate import WRONG_M, WRONG_RAD, Estimate
from rendezvous.alignment.frame_error import corrected, pose_difference
from rendezvous.geometry.occupancy_grid import Mask
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.training.frame_error.pairs import MapPair
from rendezvous.training.frame_error.perturbation import PerturbedPair

SUCCESS_M, SUCCESS_RAD = 0.3, float(np.radians(3.0))
"""An estimate within this of the truth is a success."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """One method's estimate of one pair's frame error.

    Attributes:
        pair_id: of the pair.
        theta: the true frame error θ in the window frame.
        theta_hat: the estimate θ̂; None if there is none.
        covariance: (3, 3) that the method gives to the components of θ̂⁻¹ θ; None if it gives none.
        degrees_of_freedom: of the t distribution that has this covariance; infinite: a normal one.
        ambiguous: whether the method calls its own estimate so.
        reason: why there is no estimate; empty if there is one.
        log_density: of θ under the method's posterior [1 / (m² rad)]; None if it has no posterior.
        meeting_error_m: from where T̂ = T_m0_m1 puts robot 1 to where it is.
        duration_s: of the estimate alone.
    """

    pair_id: str
    theta: SE2
    theta_hat: SE2 | None
    covariance: Array | None
    degrees_of_freedom: float
    ambiguous: bool
    reason: str
    log_density: float | None
    meeting_error_m: float
    duration_s: float

    @property
    def error(self) -> SE2:
        """θ̂⁻¹ θ, which is as well the frame error that T̂ still has; without an estimate θ̂ is the identity."""
        return pose_difference(self.theta_hat or SE2.identity(), self.theta)

    def to_json(self) -> dict[str, Any]:
        """Values as JSON holds them."""
        return {
            "pair_id": self.pair_id,
            "theta": self.theta.as_array().tolist(),
            "theta_hat": None if self.theta_hat is None else self.theta_hat.as_array().tolist(),
            "covariance": None if self.covariance is None else self.covariance.tolist(),
            "degrees_of_freedom": _none_if_infinite(self.degrees_of_freedom),
            "ambiguous": self.ambiguous,
            "reason": self.reason,
            "log_density": self.log_density,
            "meeting_error_m": self.meeting_error_m,
            "duration_s": self.duration_s,
        }

    @staticmethod
    def from_json(fields: Mapping[str, Any]) -> Outcome:
        """Inverse of `to_json`."""
        theta_hat, covariance = fields["theta_hat"], fields["covariance"]
        tails = fields["degrees_of_freedom"]
        return Outcome(
            **{
                **fields,
                "theta": SE2.from_array(fields["theta"]),
                "theta_hat": None if theta_hat is None else SE2.from_array(theta_hat),
                "covariance": None if covariance is None else np.array(covariance),
                "degrees_of_freedom": math.inf if tails is None else tails,
            }
        )


def _none_if_infinite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def outcome(
    estimate: Estimate,
    pair: MapPair,
    sample: PerturbedPair,
    *,
    log_density: float | None = None,
    duration_s: float,
) -> Outcome:
    """Set an estimate beside the truth.

    Args:
        estimate: what the method found in the sample's window.
        pair: the maps and their true transform.
        sample: the pair as the method saw it.
        log_density: of the true frame error, if the method has a posterior.
        duration_s: how long the method took.
    """
    T_hat = corrected(sample.T_estimated, estimate.theta or SE2.identity(), sample.T_m0_v)
    found, true = T_hat @ pair.T_m1_r1, pair.T_m0_r1
    return Outcome(
        pair_id=pair.pair_id,
        theta=sample.theta_v,
        theta_hat=estimate.theta,
        covariance=estimate.covariance,
        degrees_of_freedom=estimate.degrees_of_freedom,
        ambiguous=estimate.ambiguous,
        reason=estimate.reason,
        log_density=log_density,
        meeting_error_m=float(np.hypot(found.x_m - true.x_m, found.y_m - true.y_m)),
        duration_s=duration_s,
    )


@dataclass(frozen=True)
class Outcomes:
    """All outcomes of one method, as columns; N pairs in the order that all methods share."""

    rows: tuple[Outcome, ...]

    def __post_init__(self) -> None:
        assert self.rows, "no pairs, nothing to measure"

    def __len__(self) -> int:
        return len(self.rows)

    @cached_property
    def error(self) -> Array:
        """(N, 3) components x [m], y [m], yaw [rad] of θ̂⁻¹ θ; a failure counts as θ̂ = identity."""
        return np.array([row.error.as_array() for row in self.rows])

    @cached_property
    def position_m(self) -> Array:
        """(N,) distance of the error's x and y."""
        return np.hypot(self.error[:, 0], self.error[:, 1])

    @cached_property
    def heading_rad(self) -> Array:
        """(N,) absolute yaw of the error."""
        return np.abs(self.error[:, 2])

    @cached_property
    def failed(self) -> Mask:
        """(N,) where the method found no estimate."""
        return np.array([row.theta_hat is None for row in self.rows])

    @cached_property
    def flagged(self) -> Mask:
        """(N,) where the method found no estimate or calls it ambiguous."""
        return self.failed | np.array([row.ambiguous for row in self.rows])

    @cached_property
    def success(self) -> Mask:
        """(N,) where there is an estimate within SUCCESS_M and SUCCESS_RAD."""
        return ~self.failed & (self.position_m <= SUCCESS_M) & (self.heading_rad <= SUCCESS_RAD)

    @cached_property
    def wrong(self) -> Mask:
        """(N,) where the error exceeds WRONG_M or WRONG_RAD."""
        return (self.position_m > WRONG_M) | (self.heading_rad > WRONG_RAD)

    @cached_property
    def covariance(self) -> Array:
        """(N, 3, 3); NaN where there is none."""
        missing = np.full((3, 3), np.nan)
        return np.array([missing if row.covariance is None else row.covariance for row in self.rows])

    @cached_property
    def degrees_of_freedom(self) -> Array:
        """(N,) of the distributions that have the covariances."""
        return np.array([row.degrees_of_freedom for row in self.rows])

    @cached_property
    def log_density(self) -> Array:
        """(N,) of the true frame error; NaN where there is no posterior."""
        return np.array([np.nan if row.log_density is None else row.log_density for row in self.rows])

    @cached_property
    def meeting_error_m(self) -> Array:
        """(N,) how far T̂ misplaces robot 1."""
        return np.array([row.meeting_error_m for row in self.rows])

    @cached_property
    def duration_s(self) -> Array:
        """(N,) of each estimate."""
        return np.array([row.duration_s for row in self.rows])


@dataclass(frozen=True, slots=True, kw_only=True)
class Pairs:
    """What is known of the N pairs that all methods are measured on.

    Attributes:
        overlap: (N,) |known_0 ∩ known_1| / |known_0 ∪ known_1|.
        plan: (N,) number of the floor plan of each.
    """

    overlap: Array
    plan: NDArray[np.int64]

    @staticmethod
    def of(overlap: Array, plan_ids: Sequence[str]) -> Pairs:
        """From the columns of the published table."""
        _, plan = np.unique(np.array(plan_ids), return_inverse=True)
        return Pairs(overlap=np.asarray(overlap, dtype=np.float64), plan=plan.astype(np.int64))
