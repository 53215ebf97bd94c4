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

import torch
from torch import Tensor, nn
from torch.nn import functional

from rendezvous.alignment.window import OCCUPIED_CELL, OPEN_CELL, ROBOT_CELL, UNKNOWN_CELL
from rendezvous.errors import ConfigError, require_within
from rendezvous.models import se2_correlation
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
            self,
            cell_m=(1e-3, 10.0),
            coarse_factor=(1, 64),
            fine_factor=(1, 64),
            channels=(1, 4096),
            coarse_features=(1, 4096),
            fine_channels=(1, 4096),
            fine_features=(1, 4096),
            reach_cells=(0, 4096),
            heading_step_rad=(math.radians(0.1), math.radians(60.0)),
        )
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
        scores = se2_correlation.scores(grid[:, 0], grid[:, 1], heading_BH_rad, lags, lags, whole_range=True)
        return scores * torch.exp(self.coarse_log_scale)

    def fine_scores(
        self, features: Features, heading_BH_rad: Tensor, y_BHY_m: Tensor, x_BHX_m: Tensor
    ) -> Tensor:
        """(B, H, Y, X): logits of θ, each heading with close translations of its own."""
        grid, cell_m = features.fine_BMFYX, self.config.fine_cell_m
        y_BHY, x_BHX = y_BHY_m / cell_m, x_BHX_m / cell_m
        scores = se2_correlation.scores(
            grid[:, 0], grid[:, 1], heading_BH_rad, y_BHY, x_BHX, whole_range=False
        )
        return scores * torch.exp(self.fine_log_scale)
