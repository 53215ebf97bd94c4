"""The posterior of the frame error over a grid of SE(2): its peaks, their covariance, its density.

Covariances are of the components x [m], y [m], yaw [rad] of `mean⁻¹ θ`, as everywhere in this project.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous.alignment.window import SearchRange
from rendezvous.geometry.se2 import SE2, Array, wrap_angle

HalfWidths = tuple[float, float]  # half widths of a box in x and y [m] and in heading [rad]
PEAK_BOX: HalfWidths = (0.5, math.radians(7.5))
"""Two peaks closer than this are one; the cells within it belong to the peak."""
WHOLE: HalfWidths = (math.inf, math.inf)  # the box that holds a whole volume


@dataclass(frozen=True, slots=True, kw_only=True)
class Gaussian:
    """A normal distribution on SE(2)."""

    mean: SE2  # its centre
    covariance: Array  # (3, 3) of the components of `mean⁻¹ θ`
    weight: float = 1.0  # in a mixture, positive; weights need not sum to 1

    def through_cells(self, cell_m: float, cell_rad: float) -> Gaussian:
        """The distribution as cells of this size show it: one narrower than a cell still falls into one of
        them."""
        cell = np.diag([cell_m**2, cell_m**2, cell_rad**2]) / 12.0
        return replace(self, covariance=self.covariance + cell)

    def search(self, *, sigmas: float = 3.5) -> SearchRange:
        """The search around zero that reaches this many standard deviations from the mean."""
        R = SE2(0.0, 0.0, self.mean.yaw_rad).matrix()
        x, y, yaw = np.sqrt(np.diag(R @ self.covariance @ R.T)) * sigmas
        return SearchRange(
            xy_m=float(max(abs(self.mean.x_m) + x, abs(self.mean.y_m) + y)),
            yaw_rad=min(math.pi, abs(wrap_angle(self.mean.yaw_rad)) + float(yaw)),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Mode:
    """A peak of a posterior."""

    peak: SE2  # where the density is highest
    mass: float  # probability of the peak's surroundings that no higher peak has claimed, in [0, 1]


@dataclass(frozen=True, slots=True, kw_only=True)
class Posterior:
    """Probabilities of a regular grid of frame errors."""

    headings_rad: Array  # (H,) evenly spaced; the last may be a step before the first, all the way round
    ys_m: Array  # (Y,) evenly spaced
    xs_m: Array  # (X,) evenly spaced
    # Log of the probability of each cell. They sum to 1, except in scores that are not normalised yet and in
    # the rest of a posterior without one of its peaks.
    log_p_HYX: Array

    def __post_init__(self) -> None:
        shape = (self.headings_rad.size, self.ys_m.size, self.xs_m.size)
        assert self.log_p_HYX.shape == shape, f"{self.log_p_HYX.shape} is not {shape}"
        assert min(shape) >= 2, f"a posterior of {shape} cells has no spacing"

    def normalised(self) -> Posterior:
        """The softmax: the same up to a factor, with sum 1."""
        return replace(self, log_p_HYX=self.log_p_HYX - log_sum_exp(self.log_p_HYX))

    @property
    def steps(self) -> tuple[float, float, float]:
        """Spacing of headings [rad], ys and xs [m]."""
        turn, y, x = (float(axis[1] - axis[0]) for axis in (self.headings_rad, self.ys_m, self.xs_m))
        return turn, y, x

    def modes(self, count: int, *, box: HalfWidths = PEAK_BOX) -> tuple[Mode, ...]:
        """The highest peaks that lie apart, highest first; fewer if the volume is used up.

        Each peak takes all cells within the box around it, so a shoulder is no second mode.
        """
        log_p = self.log_p_HYX.copy()
        found = []
        for _ in range(count):
            peak = np.unravel_index(int(log_p.argmax()), log_p.shape)
            if log_p[peak] == -np.inf:
                break
            theta = self.theta_at(peak)
            near = np.ix_(*self._near(theta, box))
            found.append(Mode(peak=theta, mass=float(np.exp(log_p[near]).sum())))
            log_p[near] = -np.inf
        return tuple(found)

    def mean_and_covariance(self, mode: Mode, *, box: HalfWidths = PEAK_BOX) -> Gaussian:
        """The first two moments of the cells in the box around a mode."""
        moments = self.moments(mode.peak, box=box)
        R_back = SE2(0.0, 0.0, -moments.mean.yaw_rad).matrix()
        return replace(moments, covariance=R_back @ moments.covariance @ R_back.T)

    def middle_of_mass(self) -> Gaussian:
        """The first two moments of the whole volume about its highest peak."""
        return self.mean_and_covariance(self.modes(1)[0], box=WHOLE)

    def moments(self, centre: SE2, *, box: HalfWidths) -> Gaussian:
        """Like `mean_and_covariance`, but with the covariance along the axes of the grid.

        Each cell counts as spread over its own width, so that no spread is below step² / 12.
        """
        h, y, x = self._near(centre, box)
        log_p = self.log_p_HYX[np.ix_(h, y, x)]
        weights = np.exp(log_p - log_sum_exp(log_p)).reshape(-1)
        turn = _wrapped(self.headings_rad[h] - centre.yaw_rad)
        axes = np.meshgrid(turn, self.ys_m[y], self.xs_m[x], indexing="ij")
        offsets = np.stack([axis.reshape(-1) for axis in reversed(axes)], -1)
        mean = weights @ offsets
        spread = (weights[:, None] * (offsets - mean)).T @ (offsets - mean)
        spread += np.diag(np.square(self.steps[::-1])) / 12.0
        theta = SE2(mean[0], mean[1], wrap_angle(centre.yaw_rad + mean[2]))
        return Gaussian(mean=theta, covariance=spread)

    def log_density(self, theta: SE2) -> float:
        """Log of the probability density at θ [1 / (m² rad)]; -inf outside the grid.

        Trilinear between the cells' centres, falling to zero one step beyond the outermost: it integrates to
        1.
        """
        density = 1.0 / math.prod(self.steps)
        h, wh = _hat(self.headings_rad, theta.yaw_rad, self.steps[0], circle=True)
        y, wy = _hat(self.ys_m, theta.y_m, self.steps[1], circle=False)
        x, wx = _hat(self.xs_m, theta.x_m, self.steps[2], circle=False)
        weights = wh[:, None, None] * wy[:, None] * wx
        with np.errstate(divide="ignore"):
            logs = np.log(weights * density) + self.log_p_HYX[np.ix_(h, y, x)]
        return log_sum_exp(logs) if logs.size else -math.inf

    def theta_at(self, cell_HYX: Sequence[np.integer[Any] | int]) -> SE2:
        """The frame error of a cell."""
        h, y, x = cell_HYX
        return SE2(float(self.xs_m[x]), float(self.ys_m[y]), wrap_angle(float(self.headings_rad[h])))

    def middle(self) -> SE2:
        """The frame error of the middle cell."""
        return self.theta_at([size // 2 for size in self.log_p_HYX.shape])

    def holds(self, theta: SE2) -> bool:
        """Whether θ lies within the grid."""
        middle, (turn, y, x) = self.middle(), self.steps
        return (
            abs(wrap_angle(theta.yaw_rad - middle.yaw_rad)) <= 0.5 * turn * self.headings_rad.size
            and abs(theta.y_m - middle.y_m) <= 0.5 * y * self.ys_m.size
            and abs(theta.x_m - middle.x_m) <= 0.5 * x * self.xs_m.size
        )

    def log_p_at(self, theta: SE2) -> float:
        """Log of the probability of the cell whose centre is nearest to θ."""
        turn = np.abs(_wrapped(self.headings_rad - theta.yaw_rad)).argmin()
        y, x = np.abs(self.ys_m - theta.y_m).argmin(), np.abs(self.xs_m - theta.x_m).argmin()
        return float(self.log_p_HYX[turn, y, x])

    def times_prior(self, *priors: Gaussian) -> Posterior:
        """This posterior times a normal prior, normalised again."""
        log_p = self.log_p_HYX + log_prior(priors, self.headings_rad, self.ys_m, self.xs_m)
        return replace(self, log_p_HYX=log_p).normalised()

    def without(self, theta: SE2, *, box: HalfWidths = PEAK_BOX) -> Posterior:
        """The rest outside the box around θ, not normalised again."""
        log_p = self.log_p_HYX.copy()
        log_p[np.ix_(*self._near(theta, box))] = -np.inf
        return replace(self, log_p_HYX=log_p)

    def _near(self, theta: SE2, box: HalfWidths) -> tuple[NDArray[np.int64], ...]:
        """Indices of the headings, ys and xs within the box around θ."""
        half_m, half_rad = box
        return (
            np.flatnonzero(np.abs(_wrapped(self.headings_rad - theta.yaw_rad)) <= half_rad + 1e-9),
            np.flatnonzero(np.abs(self.ys_m - theta.y_m) <= half_m + 1e-9),
            np.flatnonzero(np.abs(self.xs_m - theta.x_m) <= half_m + 1e-9),
        )


COARSE_SHARE = 0.01
"""Share of the density that is the coarse posterior's: a truth may lie beyond the end of a close look."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Witnesses:
    """What speaks for each peak of a posterior."""

    log_network: Array  # (K,) log of the integral of the network's scores
    log_prior: Array  # (K,) log of the factor by which priors change it
    evidence: Array  # (K, 4) of the maps, see `rendezvous.alignment.evidence`

    def log_odds(self, of_network: float, of_evidence: Sequence[float]) -> Array:
        """(K,) log of each peak's mass up to a constant."""
        total: Array = of_network * self.log_network + self.log_prior + self.evidence @ np.array(of_evidence)
        return total

    def of_peaks(self, order: NDArray[np.int64]) -> Witnesses:
        """Those of these peaks."""
        return Witnesses(
            log_network=self.log_network[order],
            log_prior=self.log_prior[order],
            evidence=self.evidence[order],
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RefinedPosterior:
    """A posterior that is fine around its peaks and coarse elsewhere."""

    coarse: Posterior  # over the whole search
    pieces: tuple[Posterior, ...]  # close looks at each peak, each normalised, the most probable first
    masses: Array  # (K,) their probabilities
    rest: Posterior  # the coarse posterior away from all peaks; its sum and the masses add up to 1
    witnesses: Witnesses | None = None  # what the masses are made of, of the pieces in the same order

    def sharpened(self, sharpness: float) -> RefinedPosterior:
        """Each piece's density to this power, normalised again; its mass stays."""
        pieces = (replace(p, log_p_HYX=sharpness * p.log_p_HYX).normalised() for p in self.pieces)
        return replace(self, pieces=tuple(pieces))

    def weighed(self, of_network: float, of_evidence: Sequence[float]) -> RefinedPosterior:
        """The same pieces with masses of other weights, the most probable first."""
        assert self.witnesses is not None, "a posterior without witnesses cannot be weighed again"
        logs = self.witnesses.log_odds(of_network, of_evidence)
        masses = self.masses.sum() * np.exp(logs - log_sum_exp(logs))
        order = np.argsort(-masses, kind="stable")
        return replace(
            self,
            pieces=tuple(self.pieces[k] for k in order),
            masses=masses[order],
            witnesses=self.witnesses.of_peaks(order),
        )

    def best(self) -> Gaussian:
        """Mean and covariance of the most probable piece."""
        return self.pieces[0].middle_of_mass()

    def log_density(self, theta: SE2) -> float:
        """Log of the probability density at θ [1 / (m² rad)]; it integrates to 1."""
        with np.errstate(divide="ignore"):
            logs = np.log(self.masses) + np.array([piece.log_density(theta) for piece in self.pieces])
        fine = log_sum_exp(np.append(logs, self.rest.log_density(theta)))
        shares = math.log1p(-COARSE_SHARE), math.log(COARSE_SHARE)
        return float(np.logaddexp(shares[0] + fine, shares[1] + self.coarse.log_density(theta)))


def log_prior(priors: Sequence[Gaussian], headings_rad: Array, ys_m: Array, xs_m: Array) -> Array:
    """(H, Y, X): log of a mixture of normal densities at each cell of a grid, up to a constant."""
    logs = []
    for prior in priors:
        x = xs_m - prior.mean.x_m
        y = ys_m[:, None] - prior.mean.y_m
        c, s = math.cos(prior.mean.yaw_rad), math.sin(prior.mean.yaw_rad)
        turn = _wrapped(headings_rad - prior.mean.yaw_rad)[:, None, None]
        d = np.stack(np.broadcast_arrays(c * x + s * y, c * y - s * x, turn), -1)
        square = np.einsum("...i,ij,...j->...", d, np.linalg.inv(prior.covariance), d)
        log_det = np.linalg.slogdet(prior.covariance)[1]
        logs.append(math.log(prior.weight) - 0.5 * (square + log_det))
    total: Array = np.logaddexp.reduce(logs)
    return total


def _hat(axis: Array, value: float, step: float, *, circle: bool) -> tuple[NDArray[np.int64], Array]:
    """Indices of the axis' values within a step of this one, and their weights in linear interpolation."""
    distance = np.abs(_wrapped(axis - value) if circle else axis - value)
    near = np.flatnonzero(distance < step)
    return near, 1.0 - distance[near] / step


def _wrapped(angle_rad: Array) -> Array:
    """The same angles in [-pi, pi)."""
    return np.mod(angle_rad + math.pi, 2.0 * math.pi) - math.pi


def log_sum_exp(values: Array) -> float:
    """Log of the sum of the exponentials; -inf for a sum of zeros."""
    top = float(values.max())
    return top + math.log(float(np.exp(values - top).sum())) if math.isfinite(top) else top
