"""The paper's FRAME-ERROR-ESTIMATOR: a vision transformer over the pair of maps, and its convolutional
twin.

Both turn the two maps, drawn into one window, into three numbers ξ: a twist in se(2) whose exponential is the
frame error, or plainly its x, y and yaw (the paper's Table I compares the two). They share the convolutional
stem and the head; in between one has transformer layers and a class token, the other residual blocks and the
mean over all places, of the same width and number of weights.

The paper gives neither sizes nor code; the stem, the sizes and the normalisations are this project's.

Legend: B sample, 2 map (0, then 1 as the estimate places it), H W cells of the window, N its cells before
pooling, C channel, T token (the class token first), h head, D channels of a head, L layer.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from rendezvous.alignment.window import FREE_CELL, OCCUPIED_CELL
from rendezvous.errors import ConfigError, require_within
from rendezvous.models import lie
from rendezvous.models.config import Config

TOKENS_PER_SIDE = 12
WEIGHTS_STD, POSITIONS_STD = 0.02, 0.5
"""Standard deviations of fresh linear weights and class token, and of fresh positions.

Positions as faint as the weights are usual, but left a small transformer stuck at times: after 72 steps on
eight windows, over four seeds, its loss was 0.02 to 1.24 at a rate of 3e-4 and 0.16 to 1.34 at 1e-3, against
0.11 to 0.35 and 0.05 to 0.17 with these. (At 3e-4 the faint ones were ahead on three of the four seeds. The
error on unseen maps was not compared.)
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameErrorConfig(Config):
    """Shape of a network, and how to read its output."""

    vit: bool = True  # the transformer; otherwise its convolutional twin
    lie: bool = True  # the output is a twist; otherwise x [m], y [m] and yaw [rad]
    cells: int = 192  # cells along a side of the input, a power of two times 12
    cell_m: float = 0.1  # side of a cell [m]
    width: int = 256  # channels of the body
    depth: int = 6  # transformer layers; the twin has two residual blocks for every three of them
    heads: int = 8  # of each transformer layer

    def __post_init__(self) -> None:
        require_within(self, cell_m=(1e-3, 1e3), width=(8, 65536), depth=(1, 1024), heads=(1, 1024))
        halvings = self.cells // TOKENS_PER_SIDE
        if halvings < 2 or self.cells != halvings * TOKENS_PER_SIDE or halvings & (halvings - 1):
            raise ConfigError(f"frame error: cells is {self.cells}; must be 12 times 2, 4, 8 or 16 ...")
        group = 8 << (self.halvings - 1)
        if self.width % self.heads or self.width % group:
            raise ConfigError(
                f"frame error: width is {self.width}; must be a multiple of {self.heads} heads and of {group}"
            )

    @property
    def halvings(self) -> int:
        """Number of halvings in the stem, from the input down to 12 x 12 places."""
        return (self.cells // TOKENS_PER_SIDE).bit_length() - 1


def input_grid(cells_B2NN: Tensor, *, cells: int) -> Tensor:
    """(B, 2, H, W) float32 input of the networks from a `MapWindow`'s cells: free -1, unknown 0, occupied
    +1.

    Pooled to `cells` along a side by the largest value: occupied wins, then free, then unknown. (A mean, or
    every second cell, would lose the walls.) Runs on the cells' device.

    The cells are uint8 of UNKNOWN_CELL, FREE_CELL, OCCUPIED_CELL; N is a multiple of `cells`, H and W.
    """
    batch, channels, size, _ = cells_B2NN.shape
    factor = size // cells
    assert size == factor * cells, f"{size} cells cannot be pooled to {cells}"
    blocks = cells_B2NN.reshape(batch, channels, cells, factor, cells, factor)
    pooled = blocks.amax(dim=3).amax(dim=4)  # one axis after the other: three times as fast as both at once
    return (pooled == OCCUPIED_CELL).float() - (pooled == FREE_CELL).float()


def output_pose(xi_B3: Tensor, *, lie_algebra: bool) -> Tensor:
    """(B, 3) estimated frame error θ̂, x [m], y [m] and yaw in (-π, π] [rad], from a network's output."""
    pose_B3 = lie.exp(xi_B3) if lie_algebra else xi_B3
    return torch.cat([pose_B3[..., :2], lie.wrap(pose_B3[..., 2:])], dim=-1)


class FrameErrorViT(nn.Module):
    """Vision transformer whose head reads the class token's last features."""

    def __init__(self, config: FrameErrorConfig) -> None:
        super().__init__()
        self.config = config
        self.stem = _stem(config)
        self.class_token_11C = nn.Parameter(torch.empty(1, 1, config.width))
        self.positions_1TC = nn.Parameter(torch.empty(1, 1 + TOKENS_PER_SIDE**2, config.width))
        self.layers = nn.ModuleList(TransformerLayer(config) for _ in range(config.depth))
        self.norm = nn.LayerNorm(config.width)
        self.head = _Head(config)

    def forward(self, grid_B2HW: Tensor) -> Tensor:
        """(B, 3) float32 ξ of the coded pair of maps."""
        tokens_BTC = self._embedded(grid_B2HW)
        for layer in self.layers:
            tokens_BTC = layer(tokens_BTC)
        return self.head(self.norm(tokens_BTC[:, 0]))

    def with_attention(self, grid_B2HW: Tensor) -> tuple[Tensor, Tensor]:
        """(B, 3) ξ and the attention (B, L, h, T, T) behind it; rows are the tokens that look.

        Holds L h T² numbers per sample, which `forward` does not need.
        """
        tokens_BTC = self._embedded(grid_B2HW)
        attention = []
        for layer in self.layers:
            assert isinstance(layer, TransformerLayer)
            tokens_BTC, attention_BhTT = layer.with_attention(tokens_BTC)
            attention.append(attention_BhTT)
        return self.head(self.norm(tokens_BTC[:, 0])), torch.stack(attention, dim=1)

    def _embedded(self, grid_B2HW: Tensor) -> Tensor:
        places_BTC = self.stem(grid_B2HW).flatten(2).transpose(1, 2)
        class_B1C = self.class_token_11C.expand(len(places_BTC), -1, -1).to(places_BTC.dtype)
        return torch.cat([class_B1C, places_BTC], dim=1) + self.positions_1TC


def attention_rollout(attention_BLhTT: Tensor) -> Tensor:
    """(B, H, W) share of each place in the class token's last features; a sample's places sum to 1.

    Attention Rollout (Abnar & Zuidema, 2020): attention is averaged over heads and mixed half and half with
    the identity, for the residual connection, then multiplied through the layers from first to last. The
    class token's share in itself is left out.
    """
    heads_BLTT = attention_BLhTT.float().mean(dim=2)
    tokens = heads_BLTT.shape[-1]
    mixed_BLTT = 0.5 * (heads_BLTT + torch.eye(tokens, device=heads_BLTT.device))
    rollout_BTT = mixed_BLTT[:, 0]
    for layer in range(1, mixed_BLTT.shape[1]):
        rollout_BTT = mixed_BLTT[:, layer] @ rollout_BTT
    places_BP = rollout_BTT[:, 0, 1:]
    side = round((tokens - 1) ** 0.5)
    return (places_BP / places_BP.sum(dim=-1, keepdim=True)).reshape(-1, side, side)


class FrameErrorCNN(nn.Module):
    """Convolutional twin: residual blocks, then the mean over all places."""

    def __init__(self, config: FrameErrorConfig) -> None:
        super().__init__()
        self.config = config
        self.stem = _stem(config)
        # A transformer layer has 12 C² weights, a residual block 18 C².
        self.blocks = nn.Sequential(
            *(_ResidualBlock(config.width) for _ in range(round(config.depth * 2 / 3)))
        )
        self.norm = _norm(config.width)
        self.head = _Head(config)

    def forward(self, grid_B2HW: Tensor) -> Tensor:
        """(B, 3) float32 ξ of the coded pair of maps."""
        places_BCHW = functional.gelu(self.norm(self.blocks(self.stem(grid_B2HW))))
        return self.head(places_BCHW.mean(dim=(2, 3)))


FrameErrorNet = FrameErrorViT | FrameErrorCNN


def build_frame_error(config: FrameErrorConfig, *, generator: torch.Generator) -> FrameErrorNet:
    """A network with fresh weights, on the CPU.

    Weights of linear layers, the class token and the positions are drawn from normal distributions cut at two
    standard deviations, those of convolutions from He's normal distribution; biases are 0, gains 1.
    """
    with torch.device("meta"):  # PyTorch's own draws would come from its global generator
        network = FrameErrorViT(config) if config.vit else FrameErrorCNN(config)
    network.to_empty(device="cpu")
    for name, parameter in network.named_parameters():
        if name.endswith("bias"):
            nn.init.zeros_(parameter)
        elif parameter.ndim == 4:
            nn.init.kaiming_normal_(parameter, nonlinearity="relu", generator=generator)
        elif parameter.ndim == 1:
            nn.init.ones_(parameter)
        else:
            std = POSITIONS_STD if name == "positions_1TC" else WEIGHTS_STD
            nn.init.trunc_normal_(parameter, std=std, a=-2 * std, b=2 * std, generator=generator)
    return network


class TransformerLayer(nn.Module):
    """Self-attention, then a two-layer perceptron, each on normalised tokens and added to them."""

    def __init__(self, config: FrameErrorConfig) -> None:
        super().__init__()
        width = config.width
        self.heads = config.heads
        self.norm_attention = nn.LayerNorm(width)
        self.to_qkv = nn.Linear(width, 3 * width)
        self.to_out = nn.Linear(width, width)
        self.norm_mlp = nn.LayerNorm(width)
        self.mlp = nn.Sequential(nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width))

    def forward(self, tokens_BTC: Tensor) -> Tensor:
        """(B, T, C), the same as `with_attention`'s."""
        q, k, v = self._queries_keys_values(tokens_BTC)
        # PyTorch's fused attention has a slow backward pass on the CPU in bfloat16: 22 samples/s of the whole
        # network, forward and backward, against 37.
        if q.dtype == torch.bfloat16 and q.device.type == "cpu" and torch.is_grad_enabled():
            return self._added(tokens_BTC, _attention(q, k).to(v.dtype) @ v)
        return self._added(tokens_BTC, functional.scaled_dot_product_attention(q, k, v))

    def with_attention(self, tokens_BTC: Tensor) -> tuple[Tensor, Tensor]:
        """(B, T, C) and the attention (B, h, T, T), whose rows sum to 1."""
        q, k, v = self._queries_keys_values(tokens_BTC)
        attention_BhTT = _attention(q, k)
        return self._added(tokens_BTC, attention_BhTT.to(v.dtype) @ v), attention_BhTT

    def _queries_keys_values(self, tokens_BTC: Tensor) -> tuple[Tensor, ...]:
        qkv_BTC = self.to_qkv(self.norm_attention(tokens_BTC))
        return qkv_BTC.unflatten(-1, (3, self.heads, -1)).permute(2, 0, 3, 1, 4).unbind(0)

    def _added(self, tokens_BTC: Tensor, attended_BhTD: Tensor) -> Tensor:
        tokens_BTC = tokens_BTC + self.to_out(attended_BhTD.transpose(1, 2).flatten(2))
        return tokens_BTC + self.mlp(self.norm_mlp(tokens_BTC))


def _attention(q_BhTD: Tensor, k_BhTD: Tensor) -> Tensor:
    """(B, h, T, T): attention of each token to each other; rows sum to 1."""
    return torch.softmax((q_BhTD * q_BhTD.shape[-1] ** -0.5) @ k_BhTD.transpose(-2, -1), dim=-1)


class _ResidualBlock(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.body = nn.Sequential(
            _norm(width),
            nn.GELU(),
            nn.Conv2d(width, width, 3, padding=1, bias=False),
            _norm(width),
            nn.GELU(),
            nn.Conv2d(width, width, 3, padding=1),
        )

    def forward(self, places_BCHW: Tensor) -> Tensor:
        return places_BCHW + self.body(places_BCHW)


class _Head(nn.Module):
    def __init__(self, config: FrameErrorConfig) -> None:
        super().__init__()
        self.mlp = nn.Sequential(nn.Linear(config.width, config.width), nn.GELU(), nn.Linear(config.width, 3))

    def forward(self, features_BC: Tensor) -> Tensor:
        # bfloat16 has steps of 8 mm at 2 m.
        with torch.autocast(features_BC.device.type, enabled=False):
            return self.mlp(features_BC.float())


def _stem(config: FrameErrorConfig) -> nn.Sequential:
    """(B, 2, H, W) to (B, width, 12, 12)."""
    layers: list[nn.Module] = []
    channels = 2
    for halving in reversed(range(config.halvings)):
        wider = config.width >> halving
        layers += [nn.Conv2d(channels, wider, 3, stride=2, padding=1, bias=False), _norm(wider), nn.GELU()]
        channels = wider
    return nn.Sequential(*layers, nn.Conv2d(channels, config.width, 1))


def _norm(channels: int) -> nn.GroupNorm:
    # Over each sample alone: batch statistics would mix the two passes of the regularised loss.
    return nn.GroupNorm(8, channels)
