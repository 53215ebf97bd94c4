"""The learned matcher: one encoder for both maps, whose features are correlated over SE(2).

A coarse volume of scores covers the whole search at 0.2 m and 3°. Around its peaks a finer pair of features
scores any θ, as finely as needed. The softmax over the volumes is the posterior of the frame error.

Features are not equivariant by construction: random window headings in training teach it.

At a rendezvous, each map's features know where its own robot stood and what that robot sees: the right θ puts
each robot where the other one can see it.

Legend: B pair, M map (0, then 1 as the estimate places it), N cells of the window, C channel, F feature, H
heading, Y X rows and columns (of a grid, or of a volume of translations).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from rendezvous.alignment.window import OCCUPIED_CELL, OPEN_CELL, ROBOT_CELL, UNKNOWN_CELL
from rendezvous.errors import ConfigError, require_within
from rendezvous.models.config import Config


@dataclass(frozen=True, slots=True, kw_only=True)
class MatcherConfig(Config):
    """Shape of a matcher, and how to read its scores."""

    cell_m: float = 0.05  # side of a cell of the window [m]
    coarse_factor: int = 4  # cells of the window along a side of a coarse feature cell
    fine_factor: int = 2  # the same for a fine feature cell; divides `coarse_factor`
    channels: int = 32  # of the coarse encoder
    dilations: tuple[int, ...] = (1, 2, 4, 8, 16, 1, 2, 4, 8)  # of its residual 3x3 convolutions, one each
    coarse_features: int = 8  # number of features that are correlated coarsely
    # fine_channels, fine_features: the same for the fine branch.
    fine_channels: int = 16
    fine_features: int = 4
    reach_cells: int = 8  # features vanish further than this from known cells [coarse cells]
    heading_step_rad: float = math.radians(3.0)  # spacing of the coarse volume's headings; divides the circle

    def __post_init__(self) -> None:
        require_within(
            self, cell_m=(1e-3, 10.0), coarse_factor=(1, 64), fine_factor=(1, 64), channels=(1, 4096),
            coarse_features=(1, 4096), fine_channels=(1, 4096), fine_features=(1, 4096),
            reach_cells=(0, 4096), heading_step_rad=(math.radians(0.1), math.radians(60.0)),
        )  # fmt: skip
        if not all(1 <= dilation <= 256 for dilation in self.dilations):
            raise ConfigError(
                f"MatcherConfig: dilations is {list(self.dilations)}; each must be from 1 to 256"
            )
        if self.coarse_factor % self.fine_factor:
            raise ConfigError(
                f"matcher: fine_factor is {self.fine_factor}; must divide {self.coarse_factor}, the other"
            )
        if abs(math.remainder(2.0 * math.pi, self.heading_step_rad)) > 1e-9:
            raise ConfigError(f"matcher: heading_step_rad is {self.heading_step_rad}; must divide the circle")

    @property
    def coarse_cell_m(self) -> float:
        """Side of a coarse feature cell [m]."""
        return self.cell_m * self.coarse_factor

    @property
    def fine_cell_m(self) -> float:
        """Side of a fine feature cell [m]."""
        return self.cell_m * self.fine_factor


@dataclass(frozen=True, slots=True, kw_only=True)
class Features:
    """The encoder's output for a batch of windows; float32."""

    coarse_BMFYX: Tensor
    fine_BMFYX: Tensor


class Encoder(nn.Module):
    """Features of one map's cells at two resolutions."""

    def __init__(self, config: MatcherConfig) -> None:
        super().__init__()
        self.config = config
        C, C_fine = config.channels, config.fine_channels
        self.stem = nn.Conv2d(2 * config.coarse_factor**2 + 2, C, 3, padding=1)
        blocks = [nn.Conv2d(C, C, 3, padding=d, dilation=d) for d in config.dilations]
        self.blocks = nn.ModuleList(blocks)
        self.coarse_head = nn.Conv2d(C, config.coarse_features, 1)
        self.fine_stem = nn.Conv2d(2 * config.fine_factor**2, C_fine, 3, padding=1)
        self.context = nn.Conv2d(C, C_fine, 1)
        self.fine_block = nn.Conv2d(C_fine, C_fine, 3, padding=1)
        self.fine_head = nn.Conv2d(C_fine, config.fine_features, 3, padding=1)
        with torch.no_grad():
            for block in blocks:
                # There is no normalisation: the sum of the blocks must not outgrow the stem at the start.
                block.weight.mul_(0.5)

    def forward(self, cells_BNN: Tensor, sight_BNN: Tensor) -> tuple[Tensor, Tensor]:
        """Coarse and fine features, (B, F, Y, X) each, of uint8 cells coded as in a `MapWindow`."""
        config = self.config
        ratio = config.coarse_factor // config.fine_factor
        blocks_BYXc = self._blocks(cells_BNN, config.coarse_factor)
        near = self._near_known((blocks_BYXc != UNKNOWN_CELL).any(-1)[:, None].float())
        sight_BYXc = self._blocks(sight_BNN, config.coarse_factor)
        sight = [(sight_BYXc == value).float().mean(-1, keepdim=True) for value in (OPEN_CELL, ROBOT_CELL)]
        x = self.stem(torch.cat([self._shown(blocks_BYXc), *sight], -1).permute(0, 3, 1, 2))
        for block in self.blocks:
            x = x + block(functional.relu(x))
        x = functional.relu(x)
        coarse = self.coarse_head(x).float() * near
        context = functional.interpolate(self.context(x), scale_factor=float(ratio))
        cells_BCYX = self._shown(self._blocks(cells_BNN, config.fine_factor)).permute(0, 3, 1, 2)
        y = functional.relu(self.fine_stem(cells_BCYX) + context)
        y = functional.relu(y + self.fine_block(y))
        fine = self.fine_head(y).float() * functional.interpolate(near, scale_factor=float(ratio))
        return coarse.contiguous(), fine.contiguous()

    @staticmethod
    def _blocks(cells_BNN: Tensor, factor: int) -> Tensor:
        """(B, Y, X, factor²): each block of cells as channels of one cell, so that pooling loses nothing."""
        B, N = cells_BNN.shape[:2]
        size = N // factor
        return cells_BNN.view(B, size, factor, size, factor).transpose(2, 3).reshape(B, size, size, -1)

    @staticmethod
    def _shown(cells_BYXc: Tensor) -> Tensor:
        """(B, Y, X, 2c): flags of occupied, then of known."""
        return torch.cat([cells_BYXc == OCCUPIED_CELL, cells_BYXc != UNKNOWN_CELL], -1).float()

    def _near_known(self, known_B1YX: Tensor) -> Tensor:
        """1 for coarse cells within reach of a known one: features must not see the window's edge."""
        reach = self.config.reach_cells
        size = 2 * reach + 1
        rows = functional.max_pool2d(known_B1YX, (size, 1), stride=1, padding=(reach, 0))
        return functional.max_pool2d(rows, (1, size), stride=1, padding=(0, reach))


class Matcher(nn.Module):
    """Scores frame errors; `MatcherEstimator` reads the scores."""

    def __init__(self, config: MatcherConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = Encoder(config)
        # Scores are sums over thousands of cells: the scale brings them down to logits.
        self.coarse_log_scale = nn.Parameter(torch.tensor(math.log(0.01)))
        self.fine_log_scale = nn.Parameter(torch.tensor(math.log(0.01)))
        self.carried_weight = nn.Parameter(torch.tensor(1.0))

    def features(self, cells_BMNN: Tensor, sight_BMNN: Tensor | None = None) -> Features:
        """Features of both maps of each window."""
        sight_BMNN = torch.zeros_like(cells_BMNN) if sight_BMNN is None else sight_BMNN
        coarse, fine = self.encoder(cells_BMNN.flatten(0, 1), sight_BMNN.flatten(0, 1))
        B = len(cells_BMNN)
        return Features(coarse_BMFYX=coarse.unflatten(0, (B, 2)), fine_BMFYX=fine.unflatten(0, (B, 2)))

    def coarse_scores(self, features: Features, heading_BH_rad: Tensor, reach: int) -> Tensor:
        """(B, H, Y, X): logits of θ at slides of -reach..reach coarse cells along both axes."""
        grid = features.coarse_BMFYX
        lags = torch.arange(-reach, reach + 1.0, device=grid.device).expand(*heading_BH_rad.shape, -1)
        scores = se2_scores(grid[:, 0], grid[:, 1], heading_BH_rad, lags, lags, whole_range=True)
        return scores * torch.exp(self.coarse_log_scale)

    def fine_scores(
        self, features: Features, heading_BH_rad: Tensor, y_BHY_m: Tensor, x_BHX_m: Tensor
    ) -> Tensor:
        """(B, H, Y, X): logits of θ, each heading with close translations of its own."""
        grid, cell_m = features.fine_BMFYX, self.config.fine_cell_m
        y_BHY, x_BHX = y_BHY_m / cell_m, x_BHX_m / cell_m
        scores = se2_scores(grid[:, 0], grid[:, 1], heading_BH_rad, y_BHY, x_BHX, whole_range=False)
        return scores * torch.exp(self.fine_log_scale)


def moved(grid_BFYX: Tensor, heading_BH_rad: Tensor, shift_BH2: Tensor | None = None) -> Tensor:
    """(B, F, H, Y, X): each grid turned about its middle by each of its headings, zero from outside."""
    B, H = heading_BH_rad.shape
    height, width = grid_BFYX.shape[-2:]
    c, s = heading_BH_rad.cos().reshape(-1), heading_BH_rad.sin().reshape(-1)
    shift = torch.zeros(B * H, 2).to(c) if shift_BH2 is None else shift_BH2.reshape(-1, 2)
    x, y = (shift * shift.new_tensor([2.0 / width, 2.0 / height])).unbind(-1)
    # The moved grid holds at p what the grid holds at R⁻¹ (p - shift).
    rows = torch.stack([c, s, -c * x - s * y], -1), torch.stack([-s, c, s * x - c * y], -1)
    where = functional.affine_grid(torch.stack(rows, -2), [B * H, 1, height, width], align_corners=False)
    # All headings as one tall image: the grid itself need not be repeated.
    tall = functional.grid_sample(
        grid_BFYX, where.reshape(B, H * height, width, 2), padding_mode="zeros", align_corners=False
    )
    return tall.reshape(B, -1, H, height, width)


def se2_scores(
    a_BFYX: Tensor, b_BFYX: Tensor, heading_BH_rad: Tensor, y_BHY: Tensor, x_BHX: Tensor, *, whole_range: bool
) -> Tensor:
    """(B, H, Y, X): score of every heading and slide.

    Map 1 as placed is `b(θ p) = a(p)` for the true θ = (t, ψ), so the score of (ψ, t) is `Σ_p a(R_ψ⁻¹ p) ·
    b(p + t)`: map 0 is turned by ψ, and the slide t, in the frequency domain, is the translation of θ itself.

    Args:
        a_BFYX, b_BFYX: features of map 0, and of map 1 as placed.
        heading_BH_rad: the headings.
        y_BHY, x_BHX: the slides of each heading along both axes [cells], also between cells.
        whole_range: the slides reach to both sides of zero, with padding for the longest. Otherwise they lie
            close together, perhaps far away: map 0 is brought there first, which takes a smaller FFT. Then
            only cells within half their spread of the window's edge wrap around.
    """
    side = a_BFYX.shape[-1]
    shift_BH2 = torch.zeros(*heading_BH_rad.shape, 2).to(heading_BH_rad)
    size = fft_size(side)
    if whole_range:
        size = fft_size(side + math.ceil(float(torch.maximum(y_BHY.abs().max(), x_BHX.abs().max()))))
    else:
        shift_BH2 = torch.stack([x_BHX.mean(-1), y_BHY.mean(-1)], -1).round()
        x_BHX, y_BHY = x_BHX - shift_BH2[..., :1], y_BHY - shift_BH2[..., 1:]
    # One pair's spectra stay in a CPU's cache and below the size from which the allocator returns every
    # block to the system, to be cleared again: half the time of a whole batch at once.
    at_once = 1 if a_BFYX.device.type == "cpu" else len(a_BFYX)
    whole = (a_BFYX, b_BFYX, heading_BH_rad, shift_BH2, y_BHY, x_BHX)
    parts = zip(*(torch.split(tensor, at_once) for tensor in whole), strict=True)
    return torch.cat([correlation(moved(a, turn, shift), b, y, x, size) for a, b, turn, shift, y, x in parts])


def correlation(a_BFHYX: Tensor, b_BFYX: Tensor, y_BHY: Tensor, x_BHX: Tensor, size: int) -> Tensor:
    """(B, H, Y, X): `Σ_p a(p) · b(p + (x, y))` summed over features, at slides of any fraction of a cell.

    Between whole cells it is interpolated through its spectrum. A slide longer than `size` minus the grids'
    side wraps around.

    `a` is map 0, moved; `b` map 1 as placed; each heading has its slides [cells]; `size` is the side N of
    the FFT, of whose columns N // 2 + 1 are kept.
    """
    volume: Tensor = _Correlation.apply(a_BFHYX, b_BFYX, y_BHY, x_BHX, size)  # type: ignore[no-untyped-call]  # torch
    return volume


class _Correlation(torch.autograd.Function):
    """Written by hand, because both directions can then use real FFTs; autograd's are twice as slow."""

    @staticmethod
    def forward(ctx: Any, a_BFHYX: Tensor, b_BFYX: Tensor, y_BHY: Tensor, x_BHX: Tensor, size: int) -> Tensor:
        a_hat = torch.fft.rfft2(a_BFHYX, s=(size, size))
        b_hat = torch.fft.rfft2(b_BFYX, s=(size, size))
        wave_y, wave_x = _waves(y_BHY, size), _waves(x_BHX, size)[..., : size // 2 + 1]
        spectrum = torch.zeros_like(a_hat[:, 0])
        for f in range(a_hat.shape[1]):
            spectrum += a_hat[:, f].conj() * b_hat[:, f, None]
        ctx.save_for_backward(a_hat, b_hat, wave_y, wave_x)
        ctx.size, ctx.shapes = size, (a_BFHYX.shape[-2:], b_BFYX.shape[-2:])
        # A column stands for its mirror image as well, but the first and the last are their own.
        spectrum[..., 1:-1] *= 2.0
        return (wave_y @ spectrum @ wave_x.mT).real / size**2

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        a_hat, b_hat, wave_y, wave_x = ctx.saved_tensors
        (a_height, a_width), (b_height, b_width) = ctx.shapes
        size = ctx.size
        slides = wave_y.mT @ grads[0].to(wave_y.dtype) @ wave_x
        grad_b_hat = (a_hat * slides.conj()[:, None]).sum(2)
        grad_b = torch.fft.irfft2(grad_b_hat, s=(size, size))[..., :b_height, :b_width]
        grad_a_hat = b_hat[:, :, None] * slides[:, None]
        grad_a = torch.fft.irfft2(grad_a_hat, s=(size, size))[..., :a_height, :a_width]
        return grad_a, grad_b, None, None, None


def _waves(slides: Tensor, size: int) -> Tensor:
    """(..., S, N) complex: phase of each frequency for each of the S slides."""
    frequency = 2.0 * math.pi * torch.fft.fftfreq(size, device=slides.device, dtype=slides.dtype)
    angle = slides[..., None] * frequency
    return torch.polar(torch.ones_like(angle), angle)


def fft_size(cells: int) -> int:
    """The least 2^n or 3 · 2^n that is not below `cells`: sides at which an FFT is fast."""
    power = 1 << (cells - 1).bit_length()
    return 3 * power // 4 if cells <= 3 * power // 4 else power
