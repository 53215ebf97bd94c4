"""Where loops are looked for, and which are believed."""

from itertools import pairwise

import numpy as np
import pytest

from rendezvous.geometry.se2 import Array
from rendezvous.loop_closure.closing import close_loops
from rendezvous.loop_closure.matching import Loop
from rendezvous.loop_closure.submaps import Submap, SubmapPath
from rendezvous.slam.slam import compose, relative
from rendezvous.slam.surface_map import SurfaceMap

SIGMA = np.array([0.05, 0.05, 0.02])
SURE = np.array([0.03, 0.03, 0.005])  # of a loop
BEFORE, AFTER = 24, 30  # submaps once around, and in all


def ring() -> Array:
    """(M, 3) frames of submaps on a ring of 12 m, 3 m apart, a quarter of them twice."""
    at = 2.0 * np.pi / BEFORE * np.arange(AFTER)
    return np.column_stack([12.0 * np.sin(at), 12.0 * (1.0 - np.cos(at)), at])


def path_of(frames: Array, seed: int) -> SubmapPath:
    """The path that drifts."""
    rng = np.random.default_rng(seed)
    empty = SurfaceMap(extent_m=4.0, cell_m=0.5, same_side=0.7, max_weight=60.0).cropped()
    steps = [relative(a, b) + SIGMA * rng.standard_normal(3) for a, b in pairwise(frames)]
    return SubmapPath(
        submaps=[Submap(scans=np.array([i]), poses=np.zeros((1, 3)), surface=empty) for i in range(AFTER)],
        home=np.arange(AFTER),
        steps=np.array(steps),
        covariances=np.array([np.diag(SIGMA**2)] * (AFTER - 1)),
    )


class Told:
    """A matcher that is told the truth, and lies about some pairs."""

    def __init__(self, frames: Array, lies: dict[tuple[int, int], Array]) -> None:
        self.frames, self.lies, self.asked = frames, lies, list[tuple[int, int]]()

    def __call__(self, a: int, b: int, T_a_b: Array, covariance: Array) -> Loop | None:
        self.asked.append((a, b))
        true = relative(self.frames[a], self.frames[b])
        if np.hypot(*true[:2]) > 3.5:
            return None
        T = compose(true, self.lies.get((a, b), np.zeros(3)))
        return Loop(a=a, b=b, T_a_b=T, information=np.diag(SURE**-2))


def gaps_m(frames: Array, true: Array) -> Array:
    """(AFTER - BEFORE,) by how much the second time around is off the first."""
    pairs = [(k, BEFORE + k) for k in range(AFTER - BEFORE)]
    off = [relative(frames[a], frames[b]) - relative(true[a], true[b]) for a, b in pairs]
    return np.hypot(*np.array(off)[:, :2].T)


@pytest.mark.parametrize("seed", range(4))
def test_a_drifted_ring_closes(seed: int) -> None:
    frames = ring()
    path = path_of(frames, seed)
    closed = close_loops(path, Told(frames, {}))
    assert gaps_m(path.frames(), frames).min() > 0.4
    assert gaps_m(closed.frames, frames).max() < 0.05
    before, after = (np.hypot(*(p - frames)[:, :2].T).mean() for p in (path.frames(), closed.frames))
    assert after < 0.5 * before
    assert {loop.b for loop in closed.loops} >= set(range(BEFORE, AFTER))
    assert closed.rejected == 0


def test_submaps_far_apart_or_close_in_time_are_not_compared() -> None:
    frames = ring()
    matcher = Told(frames, {})
    compared = close_loops(path_of(frames, 0), matcher).compared
    assert compared == len(matcher.asked) == len(set(matcher.asked))
    assert all(b - a >= 3 for a, b in matcher.asked)
    assert all(np.hypot(*(frames[b] - frames[a])[:2]) < 13.0 for a, b in matcher.asked)


@pytest.mark.parametrize("seed", range(4))
def test_a_false_loop_is_rejected_and_said(seed: int) -> None:
    frames = ring()
    path = path_of(frames, seed)
    lies = {(0, 24): np.array([6.0, 3.0, 0.4]), (3, 27): np.array([0.5, 0.4, -0.15])}
    closed = close_loops(path, Told(frames, lies))
    assert not {(loop.a, loop.b) for loop in closed.loops} & set(lies)
    assert closed.rejected == 2
    assert gaps_m(closed.frames, frames).max() < 0.15
