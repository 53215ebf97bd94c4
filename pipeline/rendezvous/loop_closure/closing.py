"""Loops of a path in submaps: where to look for them, and what they make of the path."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from rendezvous.geometry.se2 import SE2, Array
from rendezvous.loop_closure.matching import SIGMAS, WIDEST, Loop, LoopMatcher
from rendezvous.loop_closure.submaps import SubmapPath
from rendezvous.slam.pose_graph import MOST_SQUARED, FittedPoses, Marginals, PoseGraph, fitted
from rendezvous.slam.slam import relative

_NEAR_M = 8.0  # submaps farther apart than this, and than their places are uncertain, are not compared
_LEAST_APART = 3  # submaps closer than this in time share scans, or walls that were seen in a row
_MOST_TRIED = 3  # earlier submaps that each is compared with
_SETTLED = 2.0  # loops that fit this well (squared, by their covariance) change nothing worth a fit


@dataclass(frozen=True, slots=True, kw_only=True)
class Closed:
    """What the search for loops came to."""

    frames: Array  # (M, 3) of the submaps
    loops: list[Loop]  # those that are believed
    compared: int  # pairs of submaps
    rejected: int  # loops that contradict the path or each other


def close_loops(path: SubmapPath, matcher: LoopMatcher) -> Closed:
    """Compare each submap with earlier ones nearby, in the order of driving, as a robot would.

    Submaps that no loop holds are compared once more at the end, when it is better known what is nearby.
    """
    search = _Search(path, matcher)
    for b in range(_LEAST_APART, len(path.submaps)):
        search.look_back(b)
    search.fit()
    held = {end for loop in search.believed() for end in (loop.a, loop.b)}
    for b in range(_LEAST_APART, len(path.submaps)):
        if b not in held:
            search.look_back(b)
    search.fit()
    believed = search.believed()
    return Closed(
        frames=search.frames,
        loops=believed,
        compared=len(search.tried),
        rejected=search.contradicted + len(search.loops) - len(believed),
    )


class _Search:
    """The loops so far, and the graph as it was last fitted."""

    def __init__(self, path: SubmapPath, matcher: LoopMatcher) -> None:
        self._path, self._matcher = path, matcher
        self.loops: list[Loop] = []
        self.tried: set[tuple[int, int]] = set()
        self.contradicted = 0  # loops that the path so far rules out
        steps = len(path.steps)
        first = np.arange(steps)
        self._graph = PoseGraph(
            ends=np.stack([first, first + 1], axis=1),
            motions=path.steps,
            information=np.asarray(np.linalg.inv(path.covariances)),
            claimed=np.zeros(steps, np.bool_),
        )
        self._fit = FittedPoses(poses=path.frames(), weights=np.ones(steps))
        self._marginals = Marginals(self._fit, self._graph)

    @property
    def frames(self) -> Array:
        """(M, 3) of the submaps."""
        return self._fit.poses

    def believed(self) -> list[Loop]:
        """The loops that the fit keeps."""
        kept = self._fit.kept()[len(self._path.steps) :]
        return [loop for loop, is_kept in zip(self.loops, kept, strict=False) if is_kept]

    def fit(self) -> None:
        """Fit the frames to all loops."""
        steps = self._graph
        if self.loops:
            steps = replace(
                steps,
                ends=np.concatenate([steps.ends, [(loop.a, loop.b) for loop in self.loops]]),
                motions=np.concatenate([steps.motions, [loop.T_a_b for loop in self.loops]]),
                information=np.concatenate([steps.information, [loop.information for loop in self.loops]]),
                claimed=np.concatenate([steps.claimed, np.ones(len(self.loops), np.bool_)]),
            )
        self._fit = fitted(self.frames, steps)
        self._marginals = Marginals(self._fit, steps)

    def look_back(self, b: int) -> None:
        """Compare a submap with earlier ones."""
        found = list[Loop]()
        for a, covariance in self._nearby(b):
            self.tried.add((a, b))
            loop = self._matcher(a, b, relative(self.frames[a], self.frames[b]), covariance)
            if loop is None:
                continue
            # A fit believes a lone loop whatever odometry says: the loop is the surer of the two.
            if self._squared(loop, covariance) > MOST_SQUARED:
                self.contradicted += 1
            else:
                found.append(loop)
        self.loops += found
        if any(self._squared(loop, np.zeros((3, 3))) > _SETTLED for loop in found):
            self.fit()

    def _squared(self, loop: Loop, covariance: Array) -> float:
        """How far a loop is from what the frames say with a covariance (3, 3), squared, by both."""
        off = relative(loop.T_a_b, relative(self.frames[loop.a], self.frames[loop.b]))
        off[2] = math.remainder(off[2], 2.0 * math.pi)
        return float(off @ np.linalg.solve(covariance + np.linalg.inv(loop.information), off))

    def _nearby(self, b: int) -> list[tuple[int, Array]]:
        """Earlier submaps that may show the same place, nearest first, with the covariance of b in them."""
        frames, submaps = self.frames[: b + 1], self._path.submaps
        centres = np.array([SE2.from_array(f) @ m.centre() for f, m in zip(frames, submaps, strict=False)])
        away_m = np.hypot(*(centres[:-1] - centres[-1]).T)
        found = list[tuple[int, Array]]()
        for a in np.argsort(away_m, kind="stable").tolist():
            if away_m[a] > _NEAR_M + WIDEST.xy_m or len(found) == _MOST_TRIED:
                break
            if a > b - _LEAST_APART or (a, b) in self.tried or any(abs(a - other) < 2 for other, _ in found):
                continue
            covariance = self._marginals.covariance(a, b)
            reach_m = SIGMAS * math.sqrt(float(np.linalg.eigvalsh(covariance[:2, :2]).max()))
            if away_m[a] <= _NEAR_M + min(reach_m, WIDEST.xy_m):
                found.append((a, covariance))
        return found
