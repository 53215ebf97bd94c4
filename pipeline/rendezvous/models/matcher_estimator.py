"""The learned matcher as an estimator of the frame error: θ̂ and its covariance from a window.

Legend: K peak, H heading, Y X rows and columns of a volume of translations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from rendezvous.alignment.estimate import Estimate
from rendezvous.alignment.evidence import WindowEvidence, coarse_evidence
from rendezvous.alignment.window import DEFAULT_SEARCH, MapWindow, SearchRange
from rendezvous.errors import ConfigError
from rendezvous.geometry.occupancy_grid import Cells
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.models.matcher import Features, Matcher, se2_scores
from rendezvous.models.matcher_calibration import MatcherCalibration
from rendezvous.models.posterior import (
    WHOLE,
    Gaussian,
    Mode,
    Posterior,
    RefinedPosterior,
    Witnesses,
    log_prior,
    log_sum_exp,
)

FIRST_LOOK = ((3, math.radians(1.0)), (6, 0.05), (6, 0.05))
"""Around a coarse peak, along heading, y and x: number of cells on either side, and their size [rad, m,
m]."""
LOOKS = 3  # number of first looks, each centred on the previous one's peak while that lies on its edge
CLOSE_LOOK_CELLS = (4, 5, 5)
FINEST, COARSEST = (math.radians(0.15), 0.0075, 0.0075), (math.radians(1.0), 0.06, 0.06)
CELLS_PER_SIGMA = 1.2
"""The close look: cells on either side; their size follows the width that the first look found, within
limits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MatcherEstimator:
    """Finds the frame error with a trained `Matcher`.

    Attributes:
        model: in evaluation mode; runs on its weights' device.
        search: where to look for θ.
        priors: distribution of θ before comparing the maps, in v; several are a mixture by their weights.
        peaks: most peaks of the coarse volume to look at closely.
        negligible: peaks are skipped once no more than this probability is left.
        calibration: how to read the posterior.
        uses_sight: whether it uses the robots' positions and sight, where a window has them.
    """

    model: Matcher
    search: SearchRange = DEFAULT_SEARCH
    priors: tuple[Gaussian, ...] = ()
    peaks: int = 16
    negligible: float = 1e-4
    calibration: MatcherCalibration = field(default_factory=MatcherCalibration)
    uses_sight: bool = True

    @property
    def name(self) -> str:
        """The method's name in tables."""
        return "matcher" if self.uses_sight else "matcher-maps"

    def __call__(self, window: MapWindow) -> Estimate:
        """The frame error; a failure if one of the maps is unknown in the whole window."""
        if not window.cells.any(axis=(1, 2)).all():
            return Estimate(theta=None, reason="a map has nothing known in the window")
        posterior = self.posterior(window)
        best = posterior.best()
        return Estimate(
            theta=best.mean,
            covariance=self.calibration.covariance(best.covariance),
            degrees_of_freedom=self.calibration.degrees_of_freedom,
            ambiguous=bool(posterior.masses[0] < self.calibration.least_mass),
        )

    @torch.inference_mode()
    def posterior(self, window: MapWindow) -> RefinedPosterior:
        """The posterior of θ over the search.

        Raises:
            ConfigError: the window's cells do not have the size that the model was trained on.
        """
        config = self.model.config
        if not math.isclose(window.cell_m, config.cell_m):
            raise ConfigError(
                f"matcher: cells of {window.cell_m} m; this one takes cells of {config.cell_m} m"
            )
        sight = window.sight if self.uses_sight else None
        sight = np.zeros_like(window.cells) if sight is None else sight
        features = self.model.features(*(self._cells(layer) for layer in (window.cells, sight)))
        evidence = WindowEvidence.of(window, uses_sight=self.uses_sight)
        network = self._coarse(features)
        seen = self._with_coarse_evidence(network, evidence)
        priors = (p.through_cells(config.coarse_cell_m, config.heading_step_rad) for p in self.priors)
        coarse = seen.times_prior(*priors) if self.priors else seen
        rest = coarse
        log_network, log_with_prior, pieces = list[float](), list[float](), list[Posterior]()
        for mode in self._worth_a_look(coarse):
            rest = rest.without(mode.peak)
            volume = self._close_look(features, coarse.mean_and_covariance(mode).mean)
            if any(piece.holds(volume.middle()) for piece in pieces):
                continue  # a shoulder, from which the look has moved on to the same peak
            carried = float(self.model.carried_weight) * network.log_p_at(mode.peak)
            carried += math.log(math.prod(volume.steps))
            log_network.append(log_sum_exp(volume.log_p_HYX - self._log_prior(volume)) + carried)
            log_with_prior.append(log_sum_exp(volume.log_p_HYX) + carried)
            pieces.append(self._sharpened(volume).normalised())
        # What no close look was taken at keeps its coarse probability.
        inside = 1.0 - math.exp(log_sum_exp(rest.log_p_HYX))
        witnesses = Witnesses(
            log_network=np.array(log_network),
            log_prior=np.array(log_with_prior) - np.array(log_network),
            evidence=evidence.of_alignments([piece.middle_of_mass().mean for piece in pieces]),
        )
        found = RefinedPosterior(
            coarse=coarse,
            pieces=tuple(pieces),
            masses=np.full(len(pieces), inside / len(pieces)),
            rest=rest,
            witnesses=witnesses,
        )
        return found.weighed(self.calibration.of_network, self.calibration.of_evidence)

    def _with_coarse_evidence(self, network: Posterior, evidence: WindowEvidence) -> Posterior:
        """The coarse likelihood with what walls say at each of its cells."""
        calibration = self.calibration
        of_walls = np.array(calibration.of_evidence[:2])
        tempered = calibration.of_network * network.log_p_HYX
        if not of_walls.any():
            return replace(network, log_p_HYX=tempered).normalised()
        cell_m = self.model.config.coarse_cell_m
        (walls_0, near_0, floor_0), (walls_1, near_1, floor_1) = evidence.pooled(
            self.model.config.coarse_factor
        )
        lengths = []
        slides = torch.from_numpy(network.xs_m / cell_m).to(self.model.carried_weight)
        slides = slides.expand(1, network.headings_rad.size, -1)
        for layers_0, layers_1 in (
            ((walls_0, near_0), (near_1, walls_1)),
            ((walls_0, floor_0), (floor_1, walls_1)),
        ):
            a, b = (self._tensor(np.stack(layers)) for layers in (layers_0, layers_1))
            scores = se2_scores(a, b, self._tensor(network.headings_rad), slides, slides, whole_range=True)
            lengths.append(scores[0].double().cpu().numpy())
        log_odds = coarse_evidence(*lengths) @ of_walls
        return replace(network, log_p_HYX=tempered + log_odds).normalised()

    def _worth_a_look(self, coarse: Posterior) -> tuple[Mode, ...]:
        """The highest coarse peaks, until no more than a negligible probability is left."""
        modes = coarse.modes(self.peaks)
        before = np.cumsum([0.0, *(mode.mass for mode in modes[:-1])])
        return tuple(m for m, p in zip(modes, before, strict=True) if p <= 1.0 - self.negligible)

    def _coarse(self, features: Features) -> Posterior:
        """The likelihood over the whole search, in the matcher's coarse cells."""
        config = self.model.config
        step, cell_m = config.heading_step_rad, config.coarse_cell_m
        reach = max(1, math.ceil(self.search.yaw_rad / step - 1e-6))
        around = round(2.0 * math.pi / step)
        first, count = (-reach, 2 * reach + 1) if 2 * reach + 1 < around else (-(around // 2), around)
        headings = step * np.arange(first, first + count, dtype=np.float64)
        slides = max(1, math.ceil(self.search.xy_m / cell_m - 1e-6))
        scores = self.model.coarse_scores(features, self._tensor(headings), slides)
        axis = cell_m * np.arange(-slides, slides + 1, dtype=np.float64)
        return _volume(headings, axis, axis, scores).normalised()

    def _close_look(self, features: Features, centre: SE2) -> Posterior:
        """Scores around a peak, in cells as fine as the peak is narrow; not normalised."""
        for _ in range(LOOKS):
            first = self._look(features, centre, FIRST_LOOK)
            peak = np.unravel_index(int(first.log_p_HYX.argmax()), first.log_p_HYX.shape)
            centre = first.theta_at(peak)
            if all(0 < i < n - 1 for i, n in zip(peak, first.log_p_HYX.shape, strict=True)):
                break
        around = first.normalised().moments(first.theta_at(peak), box=WHOLE)
        sigmas = np.sqrt(np.diag(around.covariance))[::-1]
        cells = zip(CLOSE_LOOK_CELLS, np.clip(sigmas / CELLS_PER_SIGMA, FINEST, COARSEST), strict=True)
        return self._look(features, around.mean, tuple((n, float(size)) for n, size in cells))

    def _look(self, features: Features, centre: SE2, cells: tuple[tuple[int, float], ...]) -> Posterior:
        """Scores on a grid around a centre; `cells` gives the number on either side and the size, for
        heading, y and x."""
        middle = (centre.yaw_rad, centre.y_m, centre.x_m)
        headings, ys_m, xs_m = (
            at + size * np.arange(-n, n + 1, dtype=np.float64)
            for at, (n, size) in zip(middle, cells, strict=True)
        )
        y_BHY, x_BHX = (self._tensor(np.tile(axis, (headings.size, 1))) for axis in (ys_m, xs_m))
        scores = self.model.fine_scores(features, self._tensor(headings), y_BHY, x_BHX)
        volume = _volume(headings, ys_m, xs_m, scores)
        return replace(volume, log_p_HYX=volume.log_p_HYX + self._log_prior(volume))

    def _sharpened(self, volume: Posterior) -> Posterior:
        """A close look with the calibrated sharpness; the priors in it keep their width."""
        prior = self._log_prior(volume)
        return replace(volume, log_p_HYX=self.calibration.sharpness * (volume.log_p_HYX - prior) + prior)

    def _log_prior(self, volume: Posterior) -> Array | float:
        """(H, Y, X), or 0 without priors."""
        if not self.priors:
            return 0.0
        return log_prior(self.priors, volume.headings_rad, volume.ys_m, volume.xs_m)

    def _cells(self, cells: Cells) -> Tensor:
        return torch.from_numpy(cells)[None].to(self.model.carried_weight.device)

    def _tensor(self, values: Array) -> Tensor:
        """Values of a single pair, on the model's device."""
        return torch.from_numpy(values)[None].to(self.model.carried_weight)


def _volume(headings_rad: Array, ys_m: Array, xs_m: Array, scores_BHYX: Tensor) -> Posterior:
    """One pair's scores, not normalised."""
    log_p = scores_BHYX[0].double().cpu().numpy()
    return Posterior(headings_rad=headings_rad, ys_m=ys_m, xs_m=xs_m, log_p_HYX=log_p)
