"""A spinning planar lidar: when and where its beams are shot, and what noise adds to their ranges."""

from __future__ import annotations

import math

import numpy as np

from rendezvous.geometry.se2 import Array
from rendezvous.simulation.robot import LidarSpec


def noisy_ranges(ranges_m: Array, spec: LidarSpec, *, rng: np.random.Generator) -> Array:
    """(B,) [m] as the sensor reports them: inf where there is no echo or it is out of the sensor's range."""
    # Normal in the range, Bernoulli for a lost echo; both always drawn, so that a beam's noise does not
    # depend on what the other beams hit.
    noise = spec.noise
    normal = rng.standard_normal(ranges_m.shape[0])
    lost = rng.random(ranges_m.shape[0]) < noise.dropout
    finite = np.where(np.isfinite(ranges_m), ranges_m, 0.0)
    measured = finite + normal * np.hypot(noise.sigma_m, noise.sigma_ratio * finite)
    if noise.step_m > 0.0:
        measured = np.round(measured / noise.step_m) * noise.step_m
    heard = np.isfinite(ranges_m) & ~lost & (measured >= spec.range_min_m) & (measured <= spec.range_max_m)
    return np.where(heard, measured, np.inf)


def beam_bearings(spec: LidarSpec) -> Array:
    """(B,) [rad] counter-clockwise from straight ahead."""
    return np.arange(spec.beams, dtype=np.float64) * (2.0 * math.pi / spec.beams)
