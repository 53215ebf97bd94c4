"""The outcome of each pair under each method, an estimate beside the truth; all of them as one tidy table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from rendezvous.alignment.estimate import WRONG_M, WRONG_RAD, Estimate
from rendezvous.alignment.frame_error import corrected, pose_difference
from rendezvous.evaluation.json_record import FiniteOrNot, JsonRecord, OptionalArray, OptionalPose, Pose
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.training.frame_error.pairs import MapPair, PerturbedPair

SUCCESS_M, SUCCESS_RAD = 0.3, float(np.radians(3.0))
"""An estimate this close to the truth in both is a success."""

OVERLAP_EDGES = (0.1, 0.25, 0.5)
OVERLAP_BINS = ("< 0.1", "0.1–0.25", "0.25–0.5", "> 0.5")


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome(JsonRecord):
    """One method's estimate of one pair's frame error."""

    pair_id: str
    theta: Pose  # the true frame error θ in the window's frame
    theta_hat: OptionalPose  # the estimate θ̂; None if there is none
    covariance: OptionalArray  # (3, 3), the method's own, of the components of θ̂⁻¹ θ; None if it gives none
    # Of the t distribution that has this covariance; infinite for a normal one.
    degrees_of_freedom: FiniteOrNot
    ambiguous: bool  # whether the method calls its own estimate so
    reason: str  # why there is no estimate; '' if there is one
    log_density: float | None  # of θ under the method's posterior [1 / (m² rad)]; None if it has no posterior
    meeting_error_m: float  # distance from where T̂ = T_m0_m1 puts robot 1 to where it is
    duration_s: float  # of the estimate alone

    @property
    def error(self) -> SE2:
        """θ̂⁻¹ θ, the frame error that T̂ still has; without an estimate θ̂ is the identity."""
        return pose_difference(self.theta_hat or SE2.identity(), self.theta)


def outcome(
    estimate: Estimate,
    pair: MapPair,
    sample: PerturbedPair,
    *,
    log_density: float | None = None,
    duration_s: float,
) -> Outcome:
    """Compare an estimate with the truth.

    Args:
        estimate: what the method found in the sample's window.
        pair: the maps and their true transform.
        sample: the pair as the method saw it.
        log_density: of the true frame error, if the method has a posterior.
        duration_s: time that the method took.
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


def outcome_table(found: Mapping[str, Sequence[Outcome]], overlap: Array) -> pd.DataFrame:
    """One row for each pair under each method; the index is the pair's number, from 0.

    Columns: method, pair_id, overlap and `overlaps`, its bin; theta_hat (None: no estimate); x_m, y_m and
    yaw_rad of θ̂⁻¹ θ, where a failure counts as θ̂ = identity, position_m, heading_rad of the same; failed (no
    estimate), flagged (no estimate, or ambiguous by the method's own account), success (an estimate within
    SUCCESS_M and SUCCESS_RAD), wrong (beyond WRONG_M or WRONG_RAD); covariance and degrees_of_freedom,
    log_density (NaN: none), meeting_m, duration_s.

    Args:
        found: outcomes by method, all of the same N pairs in the same order.
        overlap: (N,) |known_0 ∩ known_1| / |known_0 ∪ known_1| of the pairs' maps.
    """
    table = pd.concat({name: _columns(rows) for name, rows in found.items()}, names=["method"])
    table = table.reset_index("method")
    table.insert(2, "overlap", np.asarray(overlap)[table.index])
    table.insert(3, "overlaps", overlap_bins(table["overlap"]))
    table["position_m"] = np.hypot(table["x_m"], table["y_m"])
    table["heading_rad"] = table["yaw_rad"].abs()
    table["flagged"] = table["failed"] | table.pop("ambiguous")
    near = (table["position_m"] <= SUCCESS_M) & (table["heading_rad"] <= SUCCESS_RAD)
    table["success"] = ~table["failed"] & near
    table["wrong"] = (table["position_m"] > WRONG_M) | (table["heading_rad"] > WRONG_RAD)
    return table


def overlap_bins(overlap: pd.Series) -> pd.Series:
    """The bin of `OVERLAP_BINS` of each overlap; an edge belongs to the bin above it."""
    edges = [-np.inf, *OVERLAP_EDGES, np.inf]
    return pd.cut(overlap, edges, right=False, labels=list(OVERLAP_BINS))


_OUTCOME_COLUMNS = (
    *("pair_id", "theta_hat", "ambiguous", "covariance", "degrees_of_freedom"),
    *("log_density", "meeting_error_m", "duration_s"),
)


def _columns(outcomes: Sequence[Outcome]) -> pd.DataFrame:
    assert outcomes, "no pairs, nothing to measure"
    rows = [{name: getattr(row, name) for name in _OUTCOME_COLUMNS} for row in outcomes]
    table = pd.DataFrame(rows).astype({"theta_hat": object, "covariance": object, "log_density": np.float64})
    table[["x_m", "y_m", "yaw_rad"]] = [row.error.as_array() for row in outcomes]
    table["failed"] = table["theta_hat"].isna()
    return table.rename(columns={"meeting_error_m": "meeting_m"})
