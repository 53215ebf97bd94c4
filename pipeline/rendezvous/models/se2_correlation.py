"""Correlation of two feature grids over SE(2): turn one, slide it over the other in the frequency domain.

Map 1 as placed is `b(θ p) = a(p)` for the true θ = (t, ψ), so the score of (ψ, t) is `Σ_p a(R_ψ⁻¹ p) · b(p +
t)`: map 0 is turned by ψ, and the slide t is the translation of θ itself.

Legend: B pair, F feature, H heading, Y X rows and columns of a grid or of a volume of slides, N side of the
FFT, L = N // 2 + 1 its columns that are kept.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional


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


def scores(
    a_BFYX: Tensor, b_BFYX: Tensor, heading_BH_rad: Tensor, y_BHY: Tensor, x_BHX: Tensor, *, whole_range: bool
) -> Tensor:
    """(B, H, Y, X): score of every heading and slide.

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

    `a` is map 0, moved; `b` map 1 as placed; each heading has its slides [cells]; `size` is N.
    """
    scores: Tensor = _Correlation.apply(a_BFHYX, b_BFYX, y_BHY, x_BHX, size)  # type: ignore[no-untyped-call]  # torch
    return scores


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
