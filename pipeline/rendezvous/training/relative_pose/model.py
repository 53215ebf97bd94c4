"""The network of the relative pose as a trainable model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from rendezvous.errors import ConfigError
from rendezvous.models.relative_pose_network import RelativePoseConfig, RelativePoseNet, relative_pose_loss
from rendezvous.training.checkpoint import fit_weights_in_place
from rendezvous.training.loop import CurvePoint, TrainableModel
from rendezvous.training.relative_pose.data import PoseBatch

POSE_MODEL = "relative-pose"
_FEATURES = "features."
_OWN = "network."


@dataclass(frozen=True, slots=True, kw_only=True)
class PosePoint(CurvePoint):
    """A point of the curve of a pose network; distances in pixels of its input."""

    keypoints_found: float  # share of the keypoints in close looks whose belief map has a peak
    mean_distance_px: float | None  # from those peaks to the keypoints; None if none is found
    median_distance_px: float | None
    false_peaks: float  # share of looks without the robot that show a centroid

    def summary(self) -> str:
        found = f"{100.0 * self.keypoints_found:.1f} % of keypoints found"
        if self.mean_distance_px is not None:
            found += f", off by {self.mean_distance_px:.2f} px, median {self.median_distance_px:.2f} px"
        return (
            f"{self.samples} samples: loss {self.training_loss:.4g}, on validation images "
            f"{self.validation_loss:.4g}; {found}; false centroids {100.0 * self.false_peaks:.1f} %"
        )


class PoseModel(TrainableModel[PoseBatch]):
    """DOPE's network, published or small."""

    suitable_learning_rate = 3e-3
    point = PosePoint

    def __init__(self, network: RelativePoseNet) -> None:
        super().__init__()
        self.network = network
        # As the input comes, which halves a step's time on a CPU.
        network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def config(self) -> dict[str, Any]:
        return self.network.config.as_dict()

    def loss(self, batch: PoseBatch) -> tuple[Tensor, dict[str, float]]:
        """L_pose of Eq. 4, and each stage's mean squared error of belief maps and vector fields."""
        maps = self.network(batch["image_B3HW"])
        belief_B9hw, fields_B16hw = batch["belief_B9hw"], batch["fields_B16hw"]
        figures = {}
        for number, stage in enumerate(maps, start=1):
            pairs = {"belief": (stage.belief_B9hw, belief_B9hw), "fields": (stage.fields_B16hw, fields_B16hw)}
            for name, (said, true) in pairs.items():
                error = said.detach().float() - true
                figures[f"{name}_{number}"] = float(error.square().mean())
        return relative_pose_loss(maps, belief_B9hw, fields_B16hw), figures


def build_pose_model(
    settings: Mapping[str, Any],
    *,
    seed: int,
    initial_weights: Mapping[str, Tensor] | None = None,
    where: str = "",
) -> PoseModel:
    """The network on the CPU, with fresh weights or those given.

    `initial_weights` are those of such a network once trained, or VGG-19's by torchvision's names
    `features.0.weight`, ..., of which others than the features are ignored.

    Raises:
        ConfigError: a setting is wrong, or the weights do not fit.
    """
    config = RelativePoseConfig.with_settings(
        settings, where="train_pose.settings", model=POSE_MODEL, fixed={}
    )
    torch.manual_seed(seed)
    network = RelativePoseNet(config)
    model = PoseModel(network)
    if initial_weights is None:
        return model
    if is_trained(initial_weights):
        fit_weights_in_place(model, initial_weights, where=where)
    else:
        _begin_with_in_place(network, initial_weights, where=where)
    return model


def is_trained(weights: Mapping[str, Tensor]) -> bool:
    """Whether the weights are of such a network, rather than of VGG-19."""
    return any(name.startswith(_OWN) for name in weights)


def _begin_with_in_place(network: RelativePoseNet, weights: Mapping[str, Tensor], *, where: str) -> None:
    """Load the weights of the convolutions that the network shares with VGG-19."""
    if network.config.features != "vgg19":
        raise ConfigError(
            f"train_pose.initial_weights is {where}, but train_pose.settings.features is "
            f"{network.config.features!r}; must be 'vgg19' for these, or initial_weights null"
        )
    own = network.features.state_dict()
    of_dope = sorted({int(name.partition(".")[0]) for name in own})[-2:]
    taken = {}
    for name, value in own.items():
        if int(name.partition(".")[0]) in of_dope:
            continue
        given = weights.get(_FEATURES + name)
        if given is None or given.shape != value.shape:
            have = "absent" if given is None else f"of shape {tuple(given.shape)}"
            raise ConfigError(
                f"{where}: {_FEATURES}{name} is {have}; must be of shape {tuple(value.shape)}, as "
                "torchvision's vgg19 has it"
            )
        taken[name] = given
    network.features.load_state_dict(taken, strict=False)
