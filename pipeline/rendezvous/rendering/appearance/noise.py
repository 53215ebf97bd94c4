"""Periodic noise, which makes procedural surfaces uneven and tiles without a seam."""

from __future__ import annotations

import numpy as np
import scipy.fft
from numpy.typing import NDArray

Field = NDArray[np.float32]


def smooth_noise(
    rng: np.random.Generator, size_px: int, length_px: tuple[float, float], *, slope: float = 2.0
) -> Field:
    """Gaussian noise of mean 0 and standard deviation 1, periodic in both directions: (S, S).

    Args:
        rng: draws the noise.
        size_px: side S, even.
        length_px: size of the largest features, down and across.
        slope: how fast smaller features fade; 0 is white noise, 2 looks like clouds, 6 is smooth.
    """
    f_v = np.fft.fftfreq(size_px)[:, None] * length_px[0]
    f_u = np.fft.rfftfreq(size_px)[None, :] * length_px[1]
    gain = (1.0 + f_v**2 + f_u**2).astype(np.float32) ** np.float32(-0.5 * slope)
    gain[0, 0] = 0.0
    white = rng.standard_normal((size_px, size_px), dtype=np.float32)
    field: Field = scipy.fft.irfft2(scipy.fft.rfft2(white) * gain, s=(size_px, size_px))
    return field / np.float32(field.std())


def relief(height: Field, strength: float) -> Field:
    """(S, S) brightness, about 1, of a surface with heights (S, S), lit from the upper left."""
    slope = 2.0 * height - np.roll(height, 1, axis=0) - np.roll(height, 1, axis=1)
    return np.clip(1.0 + np.float32(strength) * slope, 0.0, 2.0)
