"""The loss of the paper's networks (Eq. 5 to 7).

The frame error θ says that map 1 as placed is θ applied to map 1 as it should lie: `placed(u) = aligned(θ⁻¹
u)`. So map 0, which agrees with the aligned map 1, comes to agree with the placed one when θ is applied to
it: that is the warp `θ̂ M_0` of Eq. 6, `warped(u) = M_0(θ̂⁻¹ u)`.

Legend: B sample, 2 map, C channel, H W cells, 3 a twist, or a pose x [m], y [m], yaw [rad].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from rendezvous.models import lie
from rendezvous.models.frame_error_network import output_pose


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameErrorLoss:
    """Means over a batch, scalars."""

    total: Tensor  # L of Eq. 7, which is minimised
    error: Tensor  # L_error
    reg: Tensor  # L_reg; 0 if ω is 0


def frame_error_loss(
    network: Callable[[Tensor], Tensor],
    grid_B2HW: Tensor,
    theta_B3: Tensor,
    *,
    lie_algebra: bool,
    omega: float,
    cell_m: float,
) -> FrameErrorLoss:
    """L = L_error + ω L_reg (Eq. 7). With ω > 0 the network runs twice, and gradients flow through both
    runs.

    The network gives ξ, a twist if `lie_algebra` or else a pose, for a coded pair of maps from `input_grid`;
    θ is the true frame error as a pose, ω in [0, 1] the regulariser's weight.
    """
    assert 0.0 <= omega <= 1.0, omega
    xi_B3 = network(grid_B2HW)
    error = (lie_error if lie_algebra else plain_error)(xi_B3, theta_B3).mean()
    if omega == 0.0:
        return FrameErrorLoss(total=error, error=error, reg=torch.zeros_like(error))
    theta_hat_B3 = output_pose(xi_B3, lie_algebra=lie_algebra)
    reg = regulariser(network, grid_B2HW, theta_hat_B3, cell_m=cell_m).mean()
    return FrameErrorLoss(total=error + omega * reg, error=error, reg=reg)


def lie_error(xi_B3: Tensor, theta_B3: Tensor) -> Tensor:
    """(B,) `½ dᵀ Σ⁻¹ d`, `d = log(exp(ξ) θ⁻¹)`, Σ = I: Eq. 5 for twists ξ and true poses θ."""
    d_B3 = lie.log(lie.compose(lie.exp(xi_B3), lie.inverse(theta_B3)))
    return 0.5 * d_B3.square().sum(dim=-1)


def plain_error(xi_B3: Tensor, theta_B3: Tensor) -> Tensor:
    """(B,) `½ ‖ξ − (x, y, yaw)‖²`: Table I without `lie`. The difference of the yaws is not wrapped."""
    return 0.5 * (xi_B3 - theta_B3).square().sum(dim=-1)


def regulariser(
    network: Callable[[Tensor], Tensor], grid_B2HW: Tensor, theta_hat_B3: Tensor, *, cell_m: float
) -> Tensor:
    """(B,) `‖M(θ̂ M_0, T̃ M_1)‖₂` (Eq. 6): the error that the network still finds once θ̂ has moved map 0."""
    map_0_B1HW, map_1_B1HW = grid_B2HW[:, :1], grid_B2HW[:, 1:]
    moved_B2HW = torch.cat([warp(map_0_B1HW, theta_hat_B3, cell_m=cell_m), map_1_B1HW], dim=1)
    return torch.linalg.vector_norm(network(moved_B2HW), dim=-1)


def warp(grid_BCHW: Tensor, pose_B3: Tensor, *, cell_m: float) -> Tensor:
    """(B, C, H, W) grids moved by poses about the window's centre: `warped(u) = grid(pose⁻¹ u)`.

    Bilinear and differentiable in both (a spatial transformer). Cells from outside the window are unknown, 0.
    """
    half_m = 0.5 * grid_BCHW.shape[-1] * cell_m
    x, y, yaw = lie.inverse(pose_B3).unbind(-1)
    c, s = torch.cos(yaw), torch.sin(yaw)
    rows = [torch.stack([c, -s, x / half_m], dim=-1), torch.stack([s, c, y / half_m], dim=-1)]
    # The product inside affine_grid would be rounded to bfloat16: centimetres at the window's edge.
    with torch.autocast(grid_BCHW.device.type, enabled=False):
        uv_BHW2 = functional.affine_grid(
            torch.stack(rows, dim=-2), list(grid_BCHW.shape), align_corners=False
        )
        return functional.grid_sample(
            grid_BCHW, uv_BHW2, mode="bilinear", padding_mode="zeros", align_corners=False
        )
