"""The paper's RELATIVE-POSE-ESTIMATOR: DOPE's network (Tremblay et al., 2018) and its loss (Eq. 4).

Features at a stride of 8, then stages that each see the features and the maps of the stage before. The
published network has VGG-19's first ten convolutions as features and six stages of five 7x7 convolutions; the
small one has the same plan with features of its own and narrower stages, and learns on a CPU.

Legend: B image, C channel, H W rows and columns of the image, h w of the maps (H / 8, W / 8), 9 belief maps
(the cuboid's corners, then its centroid), 16 vector fields (x, y of the direction to the centroid, by
corner).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn

from rendezvous.errors import ConfigError, require_within
from rendezvous.models.config import Config

BELIEFS, FIELDS = 9, 16
VGG_MEAN, VGG_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Of ImageNet's red, green and blue in [0, 1], on which VGG-19 was trained."""
_VGG19 = (64, 64, "pool", 128, 128, "pool", 256, 256, 256, 256, "pool", 512, 512)
_GROUP = 16  # number of channels that are normalised together


@dataclass(frozen=True, slots=True, kw_only=True)
class RelativePoseConfig(Config):
    """Shape of the network."""

    features: Literal["vgg19", "small"] = "small"  # `vgg19`, as published, or `small`
    width: int = 32  # the small features have 1, 2 and 4 times this many channels at strides 2, 4 and 8
    blocks: int = 4  # residual blocks of the small features at stride 8
    feature_channels: int = 64  # channels of the features that the stages see
    stages: int = 2  # number of stages, each estimating belief maps and vector fields from the ones before
    stage_channels: int = 32  # width of a stage
    stage_layers: int = 3  # convolutions of the later stages before their 1x1 ones
    stage_kernel: int = 7  # their size, odd

    def __post_init__(self) -> None:
        if self.features not in ("vgg19", "small"):
            raise ConfigError(f"RelativePoseConfig: features is {self.features!r}; must be vgg19 or small")
        require_within(
            self, width=(16, 512), blocks=(0, 64), feature_channels=(8, 1024), stages=(1, 16),
            stage_channels=(8, 1024), stage_layers=(1, 16), stage_kernel=(1, 31),
        )  # fmt: skip
        if self.width % _GROUP or not self.stage_kernel % 2:
            raise ConfigError(
                f"RelativePoseConfig: width {self.width}, stage_kernel {self.stage_kernel}; the width must "
                f"be a multiple of {_GROUP}, the kernel odd"
            )

    @staticmethod
    def published() -> RelativePoseConfig:
        """DOPE's own network."""
        return RelativePoseConfig(
            features="vgg19", feature_channels=128, stages=6, stage_channels=128, stage_layers=5
        )


@dataclass(frozen=True, slots=True)
class StageMaps:
    """Output of one stage."""

    belief_B9hw: Tensor  # belief maps
    fields_B16hw: Tensor  # vector fields


class RelativePoseNet(nn.Module):
    """Belief maps and vector fields of an image, stage by stage."""

    mean: Tensor
    std: Tensor

    def __init__(self, config: RelativePoseConfig) -> None:
        super().__init__()
        self.config = config
        self.features = _vgg_features(config) if config.features == "vgg19" else _small_features(config)
        inputs, width = config.feature_channels, config.stage_channels
        first = [_stage(inputs, width, 4 * width, out, layers=3, kernel=3) for out in (BELIEFS, FIELDS)]
        seen, layers, kernel = inputs + BELIEFS + FIELDS, config.stage_layers, config.stage_kernel
        later = [
            [_stage(seen, width, width, out, layers=layers, kernel=kernel) for out in (BELIEFS, FIELDS)]
            for _ in range(config.stages - 1)
        ]
        self.belief_stages = nn.ModuleList([first[0], *(pair[0] for pair in later)])
        self.field_stages = nn.ModuleList([first[1], *(pair[1] for pair in later)])
        self.register_buffer("mean", torch.tensor(VGG_MEAN)[:, None, None], persistent=False)
        self.register_buffer("std", torch.tensor(VGG_STD)[:, None, None], persistent=False)

    def forward(self, image_B3HW: Tensor) -> list[StageMaps]:
        """The maps of every stage; the last are the best."""
        image = (image_B3HW.float() / 255.0 - self.mean) / self.std
        features = self.features(image.contiguous(memory_format=torch.channels_last))
        seen, found = features, list[StageMaps]()
        for belief_stage, field_stage in zip(self.belief_stages, self.field_stages, strict=True):
            belief, field = belief_stage(seen), field_stage(seen)
            found.append(StageMaps(belief, field))
            seen = torch.cat([features, belief, field], dim=1)
        return found


def relative_pose_loss(maps: list[StageMaps], belief_B9hw: Tensor, fields_B16hw: Tensor) -> Tensor:
    """L_pose of Eq. 4: the mean squared errors of belief maps and vector fields, summed over the stages."""
    return torch.stack(
        [
            nn.functional.mse_loss(stage.belief_B9hw.float(), belief_B9hw)
            + nn.functional.mse_loss(stage.fields_B16hw.float(), fields_B16hw)
            for stage in maps
        ]
    ).sum()


class _Block(nn.Module):
    """Two normalised 3x3 convolutions beside a shortcut."""

    def __init__(self, channels: int, dilation: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            *_normalised(channels, channels, dilation=dilation), *_normalised(channels, channels)
        )

    def forward(self, x: Tensor) -> Tensor:
        y: Tensor = x + self.layers(x)
        return y


def _normalised(inputs: int, outputs: int, *, stride: int = 1, dilation: int = 1) -> list[nn.Module]:
    return [
        nn.Conv2d(inputs, outputs, 3, stride=stride, padding=dilation, dilation=dilation, bias=False),
        nn.GroupNorm(outputs // _GROUP, outputs),
        nn.ReLU(inplace=True),
    ]


def _small_features(config: RelativePoseConfig) -> nn.Sequential:
    """With four blocks a cell's features see 231 input pixels: thanks to the dilations even a near robot
    fits in."""
    w = config.width
    blocks = [_Block(4 * w, dilation=(1, 2, 4, 2)[k % 4]) for k in range(config.blocks)]
    return nn.Sequential(
        *_normalised(3, w, stride=2),
        *_normalised(w, 2 * w, stride=2),
        *_normalised(2 * w, 2 * w),
        *_normalised(2 * w, 4 * w, stride=2),
        *blocks,
        nn.Conv2d(4 * w, config.feature_channels, 1),
        nn.ReLU(inplace=True),
    )


def _vgg_features(config: RelativePoseConfig) -> nn.Sequential:
    """VGG-19 up to conv4_2 and its ReLU, numbered as in torchvision, then two convolutions of DOPE's."""
    layers, channels = list[nn.Module](), 3
    for item in _VGG19:
        if item == "pool":
            layers.append(nn.MaxPool2d(2))
        else:
            layers += [nn.Conv2d(channels, int(item), 3, padding=1), nn.ReLU(inplace=True)]
            channels = int(item)
    return nn.Sequential(
        *layers,
        nn.Conv2d(512, 256, 3, padding=1),
        nn.ReLU(inplace=True),
        nn.Conv2d(256, config.feature_channels, 3, padding=1),
        nn.ReLU(inplace=True),
    )


def _stage(inputs: int, width: int, wide: int, outputs: int, *, layers: int, kernel: int) -> nn.Sequential:
    """Convolutions, then two of 1x1, as in DOPE; unlike there the last starts small, because targets are
    mostly 0."""
    parts = list[nn.Module]()
    for layer in range(layers):
        parts += [
            nn.Conv2d(inputs if layer == 0 else width, width, kernel, padding=kernel // 2),
            nn.ReLU(inplace=True),
        ]
    last = nn.Conv2d(wide, outputs, 1)
    nn.init.normal_(last.weight, std=0.01)
    assert last.bias is not None
    nn.init.zeros_(last.bias)
    return nn.Sequential(*parts, nn.Conv2d(width, wide, 1), nn.ReLU(inplace=True), last)
