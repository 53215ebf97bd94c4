"""The pose network: DOPE's own where it is asked for, and the loss of Eq. 4."""

from __future__ import annotations

import re
from itertools import pairwise

import pytest
import torch
import yaml
from torch import nn

from rendezvous.errors import ConfigError
from rendezvous.models.relative_pose_network import (
    RelativePoseConfig,
    RelativePoseNet,
    StageMaps,
    relative_pose_loss,
)
from tests.conftest import ROOT


def convolutions(layers: nn.Module) -> list[tuple[int, int, int]]:
    """(inputs, outputs, kernel) in order; all keep the maps' size."""
    found = [layer for layer in layers.modules() if isinstance(layer, nn.Conv2d)]
    assert all(layer.padding == (layer.kernel_size[0] // 2,) * 2 for layer in found)
    return [(layer.in_channels, layer.out_channels, layer.kernel_size[0]) for layer in found]


@pytest.fixture(scope="module")
def published() -> RelativePoseNet:
    """Without memory for its 50 million weights."""
    with torch.device("meta"):
        return RelativePoseNet(RelativePoseConfig.published())


def test_the_published_network_has_the_layers_of_dope(published: RelativePoseNet):
    widths = (3, 64, 64, 128, 128, 256, 256, 256, 256, 512, 512, 256, 128)
    assert convolutions(published.features) == [(a, b, 3) for a, b in pairwise(widths)]
    pools = [i for i, layer in enumerate(published.features) if isinstance(layer, nn.MaxPool2d)]
    assert pools == [4, 9, 18]
    for stages, maps in ((published.belief_stages, 9), (published.field_stages, 16)):
        assert len(stages) == 6
        assert convolutions(stages[0]) == [*[(128, 128, 3)] * 3, (128, 512, 1), (512, maps, 1)]
        for stage in stages[1:]:
            wide = [(128 + 9 + 16, 128, 7), *[(128, 128, 7)] * 4]
            assert convolutions(stage) == [*wide, (128, 128, 1), (128, maps, 1)]


def test_maps_of_a_picture_of_400_pixels_have_50_cells(published: RelativePoseNet):
    with torch.device("meta"):
        stages = published(torch.zeros(2, 3, 400, 400, dtype=torch.uint8))
    assert len(stages) == 6
    assert {tuple(stage.belief_B9hw.shape) for stage in stages} == {(2, 9, 50, 50)}
    assert {tuple(stage.fields_B16hw.shape) for stage in stages} == {(2, 16, 50, 50)}


def test_the_docs_name_the_settings_of_the_published_network():
    page = (ROOT / "docs" / "train-and-measure.md").read_text()
    told = re.search(r"train_pose\.settings='(\{features: vgg19.*?\})'", page)
    assert told is not None
    assert RelativePoseConfig(**yaml.safe_load(told[1])) == RelativePoseConfig.published()


def test_settings_survive_their_record_and_an_unknown_one_is_told():
    config = RelativePoseConfig(width=48, stages=3)
    assert RelativePoseConfig.from_dict(config.as_dict()) == config
    with pytest.raises(ConfigError, match="RelativePoseConfig: stage is 2; must be one of features, "):
        RelativePoseConfig.from_dict({**config.as_dict(), "stage": 2})


def test_each_stage_sees_the_features_and_all_maps_of_the_stage_before():
    torch.manual_seed(0)
    net = RelativePoseNet(RelativePoseConfig(width=16, blocks=0, feature_channels=8, stages=3)).eval()
    seen = []
    for stage in net.belief_stages[1:]:
        stage.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    features = list[torch.Tensor]()
    net.features.register_forward_hook(lambda *hooked: features.append(hooked[2]))
    with torch.no_grad():
        stages = net(torch.randint(0, 255, (1, 3, 64, 64), dtype=torch.uint8))
    for given, before in zip(seen, stages, strict=False):
        assert torch.equal(given, torch.cat([features[0], before.belief_B9hw, before.fields_B16hw], dim=1))
    assert len(seen) == 2


def test_the_loss_is_the_mean_squared_error_of_both_kinds_of_maps_summed_over_stages():
    torch.manual_seed(0)
    belief, fields = torch.rand(2, 9, 4, 5), torch.rand(2, 16, 4, 5)
    stages = [StageMaps(torch.rand_like(belief), torch.rand_like(fields)) for _ in range(3)]
    by_hand = 0.0
    for stage in stages:
        by_hand += sum(((stage.belief_B9hw - belief) ** 2).flatten().tolist()) / belief.numel()
        by_hand += sum(((stage.fields_B16hw - fields) ** 2).flatten().tolist()) / fields.numel()
    assert float(relative_pose_loss(stages, belief, fields)) == pytest.approx(by_hand, rel=1e-5)
