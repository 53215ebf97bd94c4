"""Correlation of two feature grids over SE(2): turn one, slide it over the other in the frequency domain.

Map 1 as placed is `b(θ v) = a(v)` for the true θ = (t, ψ), so the score of (ψ, t) is
`Σ_p a(R_ψ⁻¹ p) · b(p + t)`: map 0 is turned by ψ, and the slide t is the translation of θ itself.

Legend: B pair, F feature, H heading, Y X rows and columns of a grid or of a volume of slides, N side of the
FFT, L = N // 2 + 1 its columns that are kept.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional


def turned(grid_BFYX: Tensor, heading_BH_rad: Tensor) -> Tensor:
    """(B, F, H, Y, X): each grid turned about its middle by each of its headings, zero from outside."""
    B, H = heading_BH_rad.shape
    height, width = grid_BFYX.shape[-2:]
    c, s = heading_BH_rad.cos().reshape(-1), heading_BH_rad.sin().reshape(-1)
    zero = torch.zeros_like(c)
    # The turned grid holds at p what the grid holds at R⁻¹ p.
    R_inverse = torch.stack([torch.stack([c, s, zero], -1), torch.stack([-s, c, zero], -1)], -2)
    where = functional.affine_grid(R_inverse, [B * H, 1, height, width], align_corners=False)
    # All headings as one tall image: the grid itself need not be repeated.
    tall = functional.grid_sample(
        grid_BFYX, where.reshape(B, H * height, width, 2), padding_mode="zeros", align_corners=False
    )
    return tall.reshape(B, -1, H, height, width)


def turned_correlation(
    a_BFYX: Tensor, b_BFYX: Tensor, heading_BH_rad: Tensor, y_BHY: Tensor, x_BHX: Tensor, *, reach: int
) -> Tensor:
    """(B, H, Y, X): score of every heading and slide.

    Args:
        a_BFYX, b_BFYX: features of map 0, and of map 1 as placed.
        heading_BH_rad: the headings.
        y_BHY, x_BHX: the slides of each heading along both axes [cells], any fraction of one.
        reach: the longest of them [cells]; what leaves the grid does not come back in at the other side.
    """
    size = fft_size(a_BFYX.shape[-1] + reach)
    # One pair's spectra stay in a CPU's cache and below the size from which the allocator returns every
    # block to the system, to be cleared again: half the time of a whole batch at once.
    at_once = 1 if a_BFYX.device.type == "cpu" else len(a_BFYX)
    parts = zip(
        *(torch.split(t, at_once) for t in (a_BFYX, b_BFYX, heading_BH_rad, y_BHY, x_BHX)), strict=True
    )
    return torch.cat([correlation(turned(a, heading), b, y, x, size) for a, b, heading, y, x in parts])


def correlation(a_BFHYX: Tensor, b_BFYX: Tensor, y_BHY: Tensor, x_BHX: Tensor, size: int) -> Tensor:
    """(B, H, Y, X): `Σ_p a(p) · b(p + (x, y))` summed over features, at slides of any fraction of a cell.

    Between whole cells it is interpolated as its spectrum says. A slide longer than `size` minus the grids'
    side wraps around.

    Args:
        a_BFHYX: map 0, turned.
        b_BFYX: map 1 as placed.
        y_BHY, x_BHX: the slides of each heading along both axes [cells].
        size: side of the FFT, N.
    """
    scores: Tensor = _Correlation.apply(a_BFHYX, b_BFYX, y_BHY, x_BHX, size)  # type: ignore[no-untyped-call]  # torch
    return scores


class _Correlation(torch.autograd.Function):
    """By hand, as both directions can then use real FFTs; what autograd does instead is twice as slow."""

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
    """(..., S, N) complex: what each slide of S does to each frequency."""
    frequency = 2.0 * math.pi * torch.fft.fftfreq(size, device=slides.device, dtype=slides.dtype)
    angle = slides[..., None] * frequency
    return torch.polar(torch.ones_like(angle), angle)


def fft_size(cells: int) -> int:
    """The least 2^n or 3 · 2^n that is not below: sides at which an FFT is quick."""
    power = 1 << (cells - 1).bit_length()
    return 3 * power // 4 if cells <= 3 * power // 4 else power
