"""Faults of recorded scans put right: readings that are none, clocks that jump."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rendezvous.geometry.se2 import Array

_SORTED_JUMP_S = 1.0  # stamps that fall by less were written out of order; by more, the clock was set
_USABLE_STAMPS = 0.8  # share of stamps that must rise for them to mean anything
_ASSUMED_STEP_S = 1.0  # between scans whose stamps mean nothing
_TOP = 0.99  # readings above this share of the largest one are looked at
_PILE = 0.002  # share of all readings that must pile up there to be echoes that never came
_SPARSE = 0.1  # and how many there may be just below, as a share of the pile


def readings(ranges_m: Array, *, range_min_m: float, range_max_m: float) -> Array:
    """The ranges, inf where there was no echo and NaN where there was no measurement.

    A reading at or beyond the lidar's range is no echo; NaN, zero, negative ones and those below its least
    range (REP 117's -inf among them) are no measurement.
    """
    cleaned = np.where(ranges_m >= range_max_m, np.inf, ranges_m)
    cleaned[~(ranges_m > max(range_min_m, 0.0))] = np.nan  # NaN fails the comparison too
    return cleaned


def no_echo_above(ranges_m: Array) -> float:
    """From which reading on [m] a log writes the lidar's largest value for no echo; inf if it does not.

    Such logs have readings piled up at their very end (81.83, 81.91: SICK's codes) and next to none below.
    """
    usable = ranges_m[np.isfinite(ranges_m)]
    if not usable.size:
        return np.inf
    top = float(usable.max())
    pile = np.count_nonzero(usable >= _TOP * top)
    below = np.count_nonzero((usable >= _TOP * _TOP * top) & (usable < _TOP * top))
    return _TOP * top if pile >= _PILE * usable.size and below <= _SPARSE * pile else np.inf


def rising_stamps(t_s: Array) -> tuple[NDArray[np.int64], Array, list[str]]:
    """Scans in order with stamps that rise.

    Stamps that fall by less than a second were written out of order and are sorted; where they fall by more
    the clock was set, and what follows is shifted; a stamp that is repeated is a scan that is repeated. Where
    most stamps mean nothing, the order of the scans stands for time.

    Args:
        t_s: (N,) stamps as recorded; may hold NaN.

    Returns:
        (M,) indices of the scans to keep, in order; (M,) their times [s]; what was done, in words.
    """
    count, known_s = len(t_s), t_s[np.isfinite(t_s)]
    if len(known_s) < 2 or np.mean(np.diff(known_s) > 0.0) < _USABLE_STAMPS:
        note = f"the stamps of its {count} scans do not rise; a scan each {_ASSUMED_STEP_S:g} s is assumed"
        scans = np.arange(count, dtype=np.int64)
        return scans, _ASSUMED_STEP_S * scans.astype(np.float64), [note]
    notes = []
    kept = np.flatnonzero(np.isfinite(t_s))
    if len(kept) < count:
        notes.append(f"{count - len(kept)} scans without a stamp are left out")
    shifted_s = t_s[kept].copy()
    steps_s = np.diff(shifted_s)
    typical_s = float(np.median(steps_s[steps_s > 0.0])) if (steps_s > 0.0).any() else _ASSUMED_STEP_S
    for i in np.flatnonzero(steps_s < -_SORTED_JUMP_S):
        notes.append(f"the clock jumps back by {-steps_s[i]:.3g} s; what follows is shifted")
        shifted_s[i + 1 :] += typical_s - steps_s[i]
    order = np.argsort(shifted_s, kind="stable")
    kept, shifted_s = kept[order], shifted_s[order]
    new = np.diff(shifted_s, prepend=-np.inf) > 0.0
    if not new.all():
        notes.append(f"{np.count_nonzero(~new)} scans with the stamp of another are left out")
    return kept[new], shifted_s[new], notes
