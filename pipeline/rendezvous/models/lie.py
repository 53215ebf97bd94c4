"""SE(2) and its Lie algebra se(2) in batches, differentiable.

Legend: B any leading axes; 3 a twist ξ = (v_x [m], v_y [m], ω [rad]) in se(2), or a pose (x [m], y [m],
yaw [rad]) in SE(2).

With ω the turn, exp maps (v, ω) to the pose (V v, ω), where V = [[a, -b], [b, a]], a = sin ω / ω and
b = (1 - cos ω) / ω. Its inverse is V⁻¹ = [[h, ω/2], [-ω/2, h]], h = (ω/2) / tan(ω/2), finite on all of
(-π, π].
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

SMALL_TURN_RAD = 0.05  # below it fractions are Taylor series; the omitted terms are under 2e-16


def exp(xi_B3: Tensor) -> Tensor:
    """(B, 3) pose of a twist; its yaw is the twist's turn, not wrapped."""
    v_x, v_y, turn = xi_B3.unbind(-1)
    sine, versine = _sin_over(turn), _one_minus_cos_over(turn)
    return torch.stack([sine * v_x - versine * v_y, versine * v_x + sine * v_y, turn], dim=-1)


def log(pose_B3: Tensor) -> Tensor:
    """(B, 3) twist of the shortest turn, in (-π, π], of a pose: the inverse of `exp` there."""
    x, y, yaw = pose_B3.unbind(-1)
    turn = wrap(yaw)
    half, h = 0.5 * turn, _half_over_tan_half(turn)
    return torch.stack([h * x + half * y, h * y - half * x, turn], dim=-1)


def compose(left_B3: Tensor, right_B3: Tensor) -> Tensor:
    """(B, 3) pose `left @ right`; yaw is the sum, not wrapped."""
    x, y, yaw = left_B3.unbind(-1)
    x_right, y_right, yaw_right = right_B3.unbind(-1)
    c, s = torch.cos(yaw), torch.sin(yaw)
    return torch.stack(
        [x + c * x_right - s * y_right, y + s * x_right + c * y_right, yaw + yaw_right], dim=-1
    )


def inverse(pose_B3: Tensor) -> Tensor:
    """(B, 3) inverse pose."""
    x, y, yaw = pose_B3.unbind(-1)
    c, s = torch.cos(yaw), torch.sin(yaw)
    return torch.stack([-c * x - s * y, s * x - c * y, -yaw], dim=-1)


def wrap(angle: Tensor) -> Tensor:
    """The same angles in (-π, π] [rad]."""
    return angle - 2.0 * math.pi * torch.ceil((angle - math.pi) / (2.0 * math.pi)).detach()


# Each fraction is evaluated where it is defined, at a turn of 1 for the small ones: the branch that
# torch.where drops must be finite too, or its gradient, zero times infinity, is NaN.


def _sin_over(turn: Tensor) -> Tensor:
    square, small = turn * turn, turn.abs() < SMALL_TURN_RAD
    safe = torch.where(small, 1.0, turn)
    series = 1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0))
    return torch.where(small, series, torch.sin(safe) / safe)


def _one_minus_cos_over(turn: Tensor) -> Tensor:
    square, small = turn * turn, turn.abs() < SMALL_TURN_RAD
    safe = torch.where(small, 1.0, turn)
    series = 0.5 * turn * (1.0 - square / 12.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0)))
    # 2 sin² of the half turn: 1 - cos would lose the digits of a small turn.
    return torch.where(small, series, 2.0 * torch.sin(0.5 * safe) ** 2 / safe)


def _half_over_tan_half(turn: Tensor) -> Tensor:
    square, small = turn * turn, turn.abs() < SMALL_TURN_RAD
    half = 0.5 * torch.where(small, 1.0, turn)
    series = 1.0 - square / 12.0 * (1.0 + square / 60.0 * (1.0 + square / 42.0))
    return torch.where(small, series, half * torch.cos(half) / torch.sin(half))
