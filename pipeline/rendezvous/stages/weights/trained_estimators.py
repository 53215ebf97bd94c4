"""Trained networks as estimators, of the frame error and of the relative pose."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from pydantic import TypeAdapter, ValidationError
from torch import Tensor, nn

from rendezvous.alignment.estimate import Estimate, FrameErrorEstimator
from rendezvous.alignment.window import WINDOW_CELL_M, WINDOW_CELLS, MapWindow, SearchRange
from rendezvous.errors import ConfigError
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.methods import METHODS
from rendezvous.models.frame_error_network import FrameErrorViT, attention_rollout, input_grid
from rendezvous.models.matcher_calibration import MatcherCalibration
from rendezvous.models.matcher_estimator import MatcherEstimator
from rendezvous.models.posterior import RefinedPosterior
from rendezvous.models.relative_pose_estimator import CloseLook, RelativePoseEstimator
from rendezvous.models.relative_pose_network import RelativePoseConfig, RelativePoseNet
from rendezvous.pose_estimation.observation_model import SeenRobot
from rendezvous.pose_estimation.pose_calibration import PoseCalibration
from rendezvous.training.checkpoint import Checkpoint, fit_weights_in_place, read_checkpoint, require_fit
from rendezvous.training.frame_error.registry import (
    DEFAULT_MODEL,
    FrameErrorModel,
    MatcherModel,
    PaperModel,
    rebuilt_model,
)
from rendezvous.training.parameters import Sampling
from rendezvous.training.relative_pose.model import POSE_MODEL, PoseModel


@dataclass(frozen=True, slots=True, kw_only=True)
class Trained:
    """A trained method."""

    estimator: FrameErrorEstimator
    record: Mapping[str, Any]
    attention: (
        Callable[[MapWindow], Array] | None
    )  # over a window's patches, (P, P); None for a network without


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkEstimator:
    """A network that gives the frame error alone."""

    name: str
    model: FrameErrorModel

    @torch.inference_mode()
    def __call__(self, window: MapWindow) -> Estimate:
        device = next(self.model.parameters()).device
        sight = np.zeros_like(window.cells) if window.sight is None else window.sight
        layers = (torch.from_numpy(layer)[None].to(device) for layer in (window.cells, sight))
        theta = self.model.theta(*layers)[0]
        return Estimate(theta=SE2.from_array(theta.double().cpu().tolist()).wrapped())


@dataclass(frozen=True, kw_only=True)
class RememberingMatcher(MatcherEstimator):
    """Keeps the posterior of the last window, so that its density costs no second pass."""

    last: dict[str, Any] = field(default_factory=dict, repr=False)

    def posterior(self, window: MapWindow) -> RefinedPosterior:
        if self.last.get("window") is not window:
            self.last.update(window=window, posterior=MatcherEstimator.posterior(self, window))
        found: RefinedPosterior = self.last["posterior"]
        return found


def _calibration(told: Any) -> MatcherCalibration:
    """The matcher's calibration; one of before 0.3.0 knows nothing of the maps' agreement."""
    if isinstance(told, dict) and "sharpness" in told and "of_evidence" not in told:
        default = MatcherCalibration()
        told = {**told, "of_network": default.of_network, "of_evidence": list(default.of_evidence)}
    return MatcherCalibration.from_dict(told)


def load(data: bytes, name: str, search: SearchRange, *, where: str, threads: int) -> Trained:
    """The trained method with these weights.

    Raises:
        StoreError: the file is damaged.
        ConfigError: the weights are of another model, or were trained on another window.
    """
    kind = METHODS[name].model
    found = _read(data, kind, where=where)
    record = found.record
    torch.set_num_threads(threads)
    with _whole_record(where):
        sampling = _sampling(record, where)
    _require_same_window(kind, sampling, where=where)
    with _whole_record(where):
        with torch.device("meta"):  # what the record claims may be larger than the memory
            claimed = rebuilt_model(kind, record["network"], sampling)
        calibration = _calibration(record.get("calibration", MatcherCalibration().as_dict()))
    require_fit(claimed, _averaged(found), where=where)
    model = rebuilt_model(kind, record["network"], sampling)
    _fill_in_place(model, found, where=where)
    if isinstance(model, MatcherModel):
        estimator = RememberingMatcher(
            model=model.network,
            search=search,
            uses_sight=name != "matcher-maps",
            calibration=calibration,
        )
        return Trained(estimator=estimator, record=record, attention=None)
    assert isinstance(model, PaperModel)
    network = model.network
    return Trained(
        estimator=NetworkEstimator(name=name, model=model),
        record=record,
        attention=_attention(network) if isinstance(network, FrameErrorViT) else None,
    )


def _sampling(record: Mapping[str, Any], where: str) -> Sampling:
    try:
        return TypeAdapter(Sampling).validate_python(record["sampling"])
    except ValidationError as error:
        fault = error.errors()[0]
        place = ".".join(str(key) for key in fault["loc"])
        raise ConfigError(f"{where}: sampling.{place}: {fault['msg']}; train anew") from error


def _require_same_window(kind: str, sampling: Sampling, *, where: str) -> None:
    """Check the window: a model of the paper needs the same size, the matcher only the same cells."""
    same_cells = math.isclose(sampling.window_cell_m, WINDOW_CELL_M)
    if same_cells and (kind == DEFAULT_MODEL or sampling.window_cells == WINDOW_CELLS):
        return
    raise ConfigError(
        f"{where}: trained on windows of {sampling.window_cells} cells of {sampling.window_cell_m:g} m; "
        f"must be {WINDOW_CELLS} of {WINDOW_CELL_M:g} m, which are measured: train anew"
    )


def _attention(network: FrameErrorViT) -> Callable[[MapWindow], Array]:
    @torch.inference_mode()
    def looked_at(window: MapWindow) -> Array:
        cells = torch.from_numpy(window.cells)[None].to(next(network.parameters()).device)
        _, attention_BLhTT = network.with_attention(input_grid(cells, cells=network.config.cells))
        places: Array = attention_rollout(attention_BLhTT)[0].double().cpu().numpy()
        return places

    return looked_at


def load_relative_pose(data: bytes, *, where: str) -> RelativePoseEstimator:
    """The estimator with these weights.

    Raises:
        StoreError: the file is damaged.
        ConfigError: the weights are of another model, or their record is incomplete.
    """
    found = _read(data, POSE_MODEL, where=where)
    record = found.record
    with _whole_record(where):
        network = RelativePoseConfig.from_dict(record["network"])
        sampling, robot = record["sampling"], record["robot"]
        look = CloseLook(
            input_px=int(sampling["input_px"]),
            span_px=float(sampling["close_span_px"]),
            sigma_cells=float(sampling["belief_sigma_cells"]),
        )
        x_m, y_m, z_m = (float(side) for side in robot["size_m"])
        T_r1_o = np.array(robot["T_r1_o"], np.float64).reshape(4, 4)
        if not (
            isinstance(robot["name"], str)
            and np.isfinite([x_m, y_m, z_m]).all()
            and np.isfinite(T_r1_o).all()
        ):
            raise ValueError(f"robot is {robot!r:.60}")
        calibration = PoseCalibration.from_dict(record.get("calibration", PoseCalibration().as_dict()))
        with torch.device("meta"):
            claimed = PoseModel(RelativePoseNet(network))
    require_fit(claimed, _averaged(found), where=where)
    model = PoseModel(RelativePoseNet(network))
    _fill_in_place(model, found, where=where)
    return RelativePoseEstimator(
        network=model.network,
        robot=SeenRobot(size_m=(x_m, y_m, z_m), T_r1_o=T_r1_o),
        close=look,
        calibration=calibration,
    )


def _read(data: bytes, kind: str, *, where: str) -> Checkpoint:
    found = read_checkpoint(data, where=where)
    with _whole_record(where):
        digests = found.record.get("data", {}).get("plan_digests") or []
        if not all(isinstance(digest, str) for digest in digests):
            raise TypeError(f"plan_digests is {digests!r:.60}")
    if found.record.get("model") != kind:
        raise ConfigError(f"{where}: weights of {found.record.get('model')!r}; must be those of {kind!r}")
    return found


@contextmanager
def _whole_record(where: str) -> Iterator[None]:
    """Turn what a record raises that `train` did not write into one line."""
    try:
        yield
    except ConfigError as error:
        raise error if where in str(error) else _faulty(where, error) from error
    except (AttributeError, LookupError, TypeError, ValueError, ArithmeticError, RuntimeError) as error:
        raise _faulty(where, error) from error


def _faulty(where: str, error: Exception) -> ConfigError:
    told = " ".join(f"{error}".split())
    return ConfigError(
        f"{where}: its record of the training has a wrong or missing entry ({told:.200}); train anew"
    )


def _averaged(found: Checkpoint) -> dict[str, Tensor]:
    return found.under("average.") or found.tensors


def _fill_in_place(model: nn.Module, found: Checkpoint, *, where: str) -> None:
    """Give the model its averaged weights, and bring it to the GPU if there is one."""
    fit_weights_in_place(model, _averaged(found), where=where)
    model.to("cuda" if torch.cuda.is_available() else "cpu").eval()
