"""The trainable models of the frame error, by name, and their errors on the validation pairs."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from rendezvous.alignment.frame_error import pose_difference
from rendezvous.alignment.window import MapWindow
from rendezvous.errors import ConfigError
from rendezvous.geometry.camera import Image
from rendezvous.geometry.se2 import SE2
from rendezvous.models.frame_error_network import (
    FrameErrorConfig,
    FrameErrorNet,
    build_frame_error,
    input_grid,
    output_pose,
)
from rendezvous.models.losses import frame_error_loss
from rendezvous.models.matcher import Matcher, MatcherConfig
from rendezvous.models.matcher_estimator import MatcherEstimator
from rendezvous.models.matcher_loss import LossSampling, matcher_loss
from rendezvous.models.table_one import ABLATION_ROWS, AblationRow
from rendezvous.training.batches import moved
from rendezvous.training.frame_error.data import Batch
from rendezvous.training.loop import CurvePoint, TrainableModel
from rendezvous.training.parameters import Sampling

DEFAULT_MODEL = "matcher"
PAPER_ROWS: dict[str, AblationRow] = {row.name: row for row in ABLATION_ROWS}
MODEL_NAMES = (DEFAULT_MODEL, *PAPER_ROWS)
_FIXED = ("vit", "lie", "cell_m")  # of the configs, following from the model's name and the window


def build_model(name: str, settings: Mapping[str, Any], sampling: Sampling, *, seed: int) -> FrameErrorModel:
    """A model with fresh weights, on the CPU.

    Args:
        name: one of `MODEL_NAMES`.
        settings: values of its config that differ from the defaults.
        sampling: the window, and the range of frame errors.
        seed: of its first weights.

    Raises:
        ConfigError: there is no such model or setting, or the settings do not fit each other or the window.
    """
    if name not in MODEL_NAMES:
        raise ConfigError(f"train.model is {name!r}; must be one of {', '.join(MODEL_NAMES)}")
    torch.manual_seed(seed)
    if name == DEFAULT_MODEL:
        fixed = {"cell_m": sampling.window_cell_m}
        config = MatcherConfig.with_settings(
            settings, where="train.settings", model=name, fixed=fixed, follows=_FIXED
        )
        _check_divides_window("coarse_factor", config.coarse_factor, sampling)
        return MatcherModel(Matcher(config), sampling)
    row = PAPER_ROWS[name]
    kind = {"vit": row.vit, "lie": row.lie}
    paper = FrameErrorConfig.with_settings(
        settings, where="train.settings", model=name, fixed=kind, follows=_FIXED
    )
    _check_divides_window("cells", paper.cells, sampling)
    paper = replace(paper, cell_m=sampling.window_cell_m * (sampling.window_cells / paper.cells))
    return PaperModel(build_frame_error(paper, generator=torch.Generator().manual_seed(seed)), row)


def rebuilt_model(name: str, config: Mapping[str, Any], sampling: Sampling) -> FrameErrorModel:
    """The model of trained weights, whatever the defaults are by now.

    Raises:
        ConfigError: the config is not of this model.
    """
    if name == DEFAULT_MODEL:
        return MatcherModel(Matcher(MatcherConfig.from_dict(config)), sampling)
    network = build_frame_error(FrameErrorConfig.from_dict(config), generator=torch.Generator())
    return PaperModel(network, PAPER_ROWS[name])


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameErrorPoint(CurvePoint):
    """A point of the curve of a frame-error model.

    The errors are the mean absolute components of θ̂⁻¹ θ on the validation pairs.
    """

    error_x_m: float
    error_y_m: float
    error_yaw_rad: float

    def summary(self) -> str:
        return (
            f"{self.samples} samples: loss {self.training_loss:.4g}, on validation pairs "
            f"{self.validation_loss:.4g}, mean error {self.error_x_m:.3f} m, {self.error_y_m:.3f} m, "
            f"{self.error_yaw_rad:.3f} rad"
        )


class FrameErrorModel(TrainableModel[Batch]):
    """A network that finds the frame error in a window."""

    point = FrameErrorPoint

    @abstractmethod
    def theta(self, cells_B2NN: Tensor, sight_B2NN: Tensor) -> Tensor:
        """(B, 3) float32 estimated frame error: x [m], y [m], yaw [rad]."""


class PaperModel(FrameErrorModel):
    """A row of the paper's Table I."""

    suitable_learning_rate = 5e-4

    def __init__(self, network: FrameErrorNet, row: AblationRow) -> None:
        super().__init__()
        self.network, self.row = network, row

    def config(self) -> dict[str, Any]:
        return self.network.config.as_dict()

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, float]]:
        """L of Eq. 7, and its parts."""
        config = self.network.config
        found = frame_error_loss(
            self.network,
            input_grid(batch["cells"], cells=config.cells),
            batch["theta"],
            lie_algebra=config.lie,
            omega=self.row.omega,
            cell_m=config.cell_m,
        )
        return found.total, {"error": float(found.error.detach()), "reg": float(found.reg.detach())}

    def theta(self, cells_B2NN: Tensor, sight_B2NN: Tensor) -> Tensor:
        """The network's output as a pose; it sees the maps alone."""
        config = self.network.config
        xi_B3 = self.network(input_grid(cells_B2NN, cells=config.cells))
        return output_pose(xi_B3, lie_algebra=config.lie)


class MatcherModel(FrameErrorModel):
    """The learned matcher; its loss and search cover the samples' range of frame errors."""

    suitable_learning_rate = 6e-3

    def __init__(self, network: Matcher, sampling: Sampling) -> None:
        super().__init__()
        self.network, self.cell_m = network, sampling.window_cell_m
        self.search = sampling.perturbation.search()

    def config(self) -> dict[str, Any]:
        return self.network.config.as_dict()

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, float]]:
        """Cross-entropy of the coarse and the fine volume."""
        looks = LossSampling()
        looks = replace(looks, xy_m=max(looks.xy_m, self.search.xy_m))
        return matcher_loss(self.network, batch["cells"], batch["theta"], looks, sight_BMNN=batch["sight"])

    def theta(self, cells_B2NN: Tensor, sight_B2NN: Tensor) -> Tensor:
        """The posterior's mean; zero where one of the maps shows nothing."""
        estimator = MatcherEstimator(model=self.network, search=self.search)
        windows = [
            MapWindow(cells=cells, cell_m=self.cell_m, sight=sight)
            for cells, sight in zip(cells_B2NN.cpu().numpy(), sight_B2NN.cpu().numpy(), strict=True)
        ]
        thetas = [estimator(window).theta or SE2.identity() for window in windows]
        return torch.tensor([theta.as_array().tolist() for theta in thetas], dtype=torch.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameErrorValidation:
    """Measures models on fixed pairs."""

    batches: Sequence[Batch]
    device: torch.device
    seed: int

    @torch.no_grad()
    def figures(self, model: FrameErrorModel) -> dict[str, float | None]:
        """The errors of a `FrameErrorPoint`, in float32, of a model in evaluation mode."""
        losses, errors = [], []
        for number, batch in enumerate(self.batches):
            torch.manual_seed(self.seed + number)
            there = moved(batch, self.device)
            losses.append(float(model.loss(there)[0]) * len(batch["theta"]))
            theta_hat_B3 = model.theta(there["cells"], there["sight"]).cpu()
            for estimated, true in zip(theta_hat_B3.tolist(), batch["theta"].tolist(), strict=True):
                errors.append(pose_difference(SE2(*estimated), SE2(*true)).as_array())
        x_m, y_m, yaw_rad = np.abs(np.array(errors)).mean(axis=0).tolist()
        loss = sum(losses) / len(errors)
        return {"validation_loss": loss, "error_x_m": x_m, "error_y_m": y_m, "error_yaw_rad": yaw_rad}

    def pictures(self, model: FrameErrorModel) -> dict[str, Image]:
        return {}


def _check_divides_window(key: str, value: int, sampling: Sampling) -> None:
    if sampling.window_cells % value:
        raise ConfigError(
            f"train.settings: {key} is {value}; must divide the window's {sampling.window_cells} cells "
            "(train.sampling.window_cells)"
        )
