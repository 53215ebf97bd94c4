"""The pose network as it is trained: it learns, goes on after a kill, and begins with VGG-19's features."""

from __future__ import annotations

from dataclasses import replace
from itertools import repeat

import numpy as np
import pytest
import torch

from rendezvous.errors import ConfigError
from rendezvous.models.relative_pose_network import RelativePoseConfig, RelativePoseNet
from rendezvous.training.batches import training_loader
from rendezvous.training.checkpoint import checkpoint_bytes, read_checkpoint, restore_in_place
from rendezvous.training.loop import Processes, TrainingState, fit
from rendezvous.training.parameters import Budget, Optimisation
from rendezvous.training.relative_pose.data import (
    PoseSample,
    PoseTrainingBatches,
    pose_batch,
    validation_samples,
)
from rendezvous.training.relative_pose.model import PosePoint, build_pose_model
from rendezvous.training.relative_pose.poses import PoseTable
from rendezvous.training.relative_pose.sampling import PoseSampling
from rendezvous.training.relative_pose.validation import PoseValidation
from tests.training.tiny import Losses, killed_by

TINY = {"width": 16, "blocks": 0, "feature_channels": 16, "stages": 2, "stage_channels": 8, "stage_layers": 1}
SAMPLING = PoseSampling(input_px=64, greatest_span_px=60.0, close_span_px=40.0, close_jitter_px=4.0)
SETTINGS = Optimisation(batch_size=4, learning_rate=1e-2, precision="fp32")
CPU = torch.device("cpu")


def trained(state, batches, *, samples: int, killed_after: int | None = None) -> list[float]:
    losses = Losses(killed_after=killed_after)
    with killed_by(KeyboardInterrupt, when=killed_after is not None):
        fit(
            state,
            batches,
            SETTINGS,
            Budget(samples=samples, duration_s=None),
            seed=0,
            processes=Processes(),
            observer=losses,
            clock=lambda: 0.0,
        )
    return losses.losses


def test_a_killed_run_goes_on_to_the_same_curve(poses: PoseTable):
    def run(state, **options) -> list[float]:
        source = PoseTrainingBatches(poses, SAMPLING, seed=0, batch_size=4)
        loader = training_loader(source, first_step=state.step, workers=0, pin_memory=False)
        return trained(state, loader, samples=32, **options)

    whole, killed = (TrainingState.fresh(build_pose_model(TINY, seed=0), SETTINGS) for _ in range(2))
    losses = run(whole)
    before = run(killed, killed_after=3)
    killed.curve.append(_point())
    checkpoint = read_checkpoint(checkpoint_bytes(killed, {}), where="here")
    resumed = TrainingState.fresh(build_pose_model(TINY, seed=1), SETTINGS)
    restore_in_place(resumed, checkpoint, where="here")
    assert resumed.curve == [_point()]
    assert before + run(resumed) == pytest.approx(losses, rel=1e-5)
    for name, value in whole.average.state_dict().items():
        assert torch.allclose(resumed.average.state_dict()[name], value, atol=1e-6)


def _point() -> PosePoint:
    return PosePoint(
        samples=12,
        elapsed_s=0.0,
        training_loss=1.0,
        validation_loss=1.0,
        keypoints_found=0.0,
        mean_distance_px=None,
        median_distance_px=None,
        false_peaks=0.0,
    )


def test_four_images_are_learnt_by_heart(poses: PoseTable):
    looks = validation_samples(poses, SAMPLING, seed=0, count=4)
    close = [sample for sample in looks if sample.close]
    state = TrainingState.fresh(build_pose_model(TINY, seed=0), SETTINGS)
    losses = trained(state, repeat(pose_batch(close, SAMPLING)), samples=4 * 250)
    assert losses[-1] < 0.15 * losses[0]
    found = PoseValidation(samples=close, sampling=SAMPLING, device=CPU).figures(state.average)
    assert found["keypoints_found"] > 0.9
    assert found["median_distance_px"] < 1.5


class Knowing(torch.nn.Module):
    """Gives the target maps of the samples, shifted by whole cells along u."""

    def __init__(self, samples: list[PoseSample], cells: int) -> None:
        super().__init__()
        batch = pose_batch(samples, SAMPLING)
        self.maps = {
            image.numpy().tobytes(): torch.roll(belief, cells, dims=-1)
            for image, belief in zip(batch["image_B3HW"], batch["belief_B9hw"], strict=True)
        }

    def network(self, image_B3HW):
        belief = torch.stack([self.maps[image.numpy().tobytes()] for image in image_B3HW])
        return [type("Stage", (), {"belief_B9hw": belief})]

    def loss(self, batch):
        return torch.tensor(float(len(batch["image_B3HW"]))), {}


@pytest.mark.parametrize("cells", [0, 1])
def test_validation_tells_how_far_peaks_are_off(poses: PoseTable, cells: int):
    sampling = replace(SAMPLING, close_span_px=20.0, close_jitter_px=0.0, least_scale=0.01)
    samples = validation_samples(poses, sampling, seed=0, count=6)
    found = PoseValidation(samples=samples, sampling=sampling, device=CPU).figures(Knowing(samples, cells))
    assert found["keypoints_found"] == 1.0
    assert found["median_distance_px"] == pytest.approx(8.0 * cells, abs=0.4)
    assert found["mean_distance_px"] == pytest.approx(8.0 * cells, abs=0.4)
    assert found["false_peaks"] == 0.0


def test_false_centroids_are_told(poses: PoseTable):
    samples = [s for s in validation_samples(poses, SAMPLING, seed=0, count=6) if s.close]
    absent = [PoseSample(image=s.image, uv_px=np.full((9, 2), np.nan), close=False) for s in samples[:3]]
    images = [PoseSample(image=255 - s.image, uv_px=s.uv_px, close=True) for s in samples]
    validation = PoseValidation(samples=[*images, *absent], sampling=SAMPLING, device=CPU)
    assert validation.figures(Knowing([*samples, *images], 0))["false_peaks"] == 1.0
    pictures = validation.pictures(Knowing([*samples, *images], 0))
    assert pictures["belief_maps"].shape == (3 * 128, 4 * 128, 3)


def test_each_stage_s_losses_sum_to_the_total(poses: PoseTable):
    model = build_pose_model(TINY, seed=0)
    total, figures = model.loss(PoseTrainingBatches(poses, SAMPLING, seed=0, batch_size=4)[0])
    assert sorted(figures) == ["belief_1", "belief_2", "fields_1", "fields_2"]
    assert sum(figures.values()) == pytest.approx(float(total.detach()), rel=1e-5)


def vgg19() -> dict[str, torch.Tensor]:
    torch.manual_seed(7)
    whole = RelativePoseNet(RelativePoseConfig(features="vgg19", stages=1)).features.state_dict()
    named = {f"features.{name}": value for name, value in whole.items() if int(name.split(".")[0]) < 23}
    return named | {"classifier.0.weight": torch.zeros(2, 2), "features.34.weight": torch.zeros(3)}


def test_initial_weights_are_taken_and_the_rest_is_drawn():
    weights = vgg19()
    model = build_pose_model(
        {"features": "vgg19", "stages": 1}, seed=0, initial_weights=weights, where="vgg.safetensors"
    )
    own = model.network.features.state_dict()
    assert all(torch.equal(own[name.removeprefix("features.")], weights[name]) for name in _used(weights))
    plain = build_pose_model({"features": "vgg19", "stages": 1}, seed=0).network.features.state_dict()
    assert torch.equal(own["23.weight"], plain["23.weight"])
    assert not torch.equal(own["21.weight"], plain["21.weight"])


def test_a_trained_network_s_weights_are_taken_whole():
    trained = build_pose_model(TINY, seed=5).state_dict()
    model = build_pose_model(TINY, seed=0, initial_weights=trained, where="trained.safetensors")
    assert all(torch.equal(value, trained[name]) for name, value in model.state_dict().items())
    with pytest.raises(ConfigError, match=r"^trained.safetensors: its weights do not fit the model"):
        build_pose_model(TINY | {"stages": 1}, seed=0, initial_weights=trained, where="trained.safetensors")


def _used(weights: dict[str, torch.Tensor]) -> list[str]:
    return [name for name in weights if name.startswith("features.") and "34" not in name]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"features.5.weight": None},
            r"^vgg: features.5.weight is absent; must be of shape \(128, 64, 3, 3\)",
        ),
        (
            {"features.0.bias": torch.zeros(3)},
            r"^vgg: features.0.bias is of shape \(3,\); must be of shape \(64,\), as torchvision's vgg19",
        ),
    ],
)
def test_features_that_do_not_fit_are_told(change: dict, said: str):
    weights = {name: value for name, value in (vgg19() | change).items() if value is not None}
    with pytest.raises(ConfigError, match=said):
        build_pose_model({"features": "vgg19", "stages": 1}, seed=0, initial_weights=weights, where="vgg")


def test_features_for_a_network_with_its_own_are_told():
    with pytest.raises(ConfigError, match=r"train_pose.settings.features is 'small'; must be 'vgg19'"):
        build_pose_model(TINY, seed=0, initial_weights={}, where="vgg")
