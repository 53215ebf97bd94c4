"""ORB features and RANSAC: how m-explore's map_merge finds where one map lies in the other.

Hörner, "Map-merging for multi-robot system", 2016, ROS package multirobot_map_merge: features of the grids as
images, nearest two neighbours with a ratio test, RANSAC, OpenCV's confidence of the match. Its default
feature, AKAZE, is not in OpenCV 5; ORB is its other one. It fits a similarity; maps have no scale to find, so
here the motion is rigid. Where map_merge goes on with the identity, this fails and says why.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import ClassVar

import cv2
import numpy as np
from skimage.measure import ransac
from skimage.transform import EuclideanTransform

from rendezvous.alignment.estimate import Estimate
from rendezvous.alignment.window import MapWindow
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN
from rendezvous.geometry.se2 import SE2, Array

_GREYS = np.array([UNKNOWN, FREE, OCCUPIED], np.uint8)  # a window's cell values in map_server's greys


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbRansac:
    """Rigid motion between the ORB features of both maps.

    Attributes:
        features: most features per map.
        ratio: a match's distance is below this share of the second nearest one's.
        least_matches: fewer are a failure.
        inlier_cells: largest error of an inlier.
        iterations, certainty: of RANSAC, which draws the same samples for every window.
        least_confidence: `inliers / (8 + 0.3 matches)` below this is a failure.
    """

    features: int = 500
    ratio: float = 0.7
    least_matches: int = 6
    inlier_cells: float = 3.0
    iterations: int = 2000
    certainty: float = 0.99
    least_confidence: float = 1.0

    name: ClassVar[str] = "ORB + RANSAC"

    def __call__(self, window: MapWindow) -> Estimate:
        """The frame error; a failure with too few or too inconsistent matches."""
        p_0, p_1 = self._matches(window)
        if len(p_0) < self.least_matches:
            return Estimate(
                theta=None, reason=f"{len(p_0)} matches; at least {self.least_matches} are needed"
            )
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "No inliers found")
            theta, inliers = ransac(
                (p_0, p_1),
                EuclideanTransform,
                min_samples=2,
                residual_threshold=self.inlier_cells * window.cell_m,
                max_trials=self.iterations,
                stop_probability=self.certainty,
                rng=np.random.default_rng(0),
            )
        if inliers is None:
            return Estimate(theta=None, reason=f"no motion explains any of {len(p_0)} matches")
        confidence = float(inliers.sum()) / (8.0 + 0.3 * len(p_0))
        if confidence < self.least_confidence:
            reason = f"confidence {confidence:.2f}; at least {self.least_confidence:g} is needed"
            return Estimate(theta=None, reason=reason)
        x_m, y_m = theta.translation
        return Estimate(theta=SE2(float(x_m), float(y_m), float(theta.rotation)).wrapped())

    def _matches(self, window: MapWindow) -> tuple[Array, Array]:
        """(M, 2), (M, 2) [m] in v: matched features of map 0 and map 1."""
        orb = cv2.ORB.create(nfeatures=self.features)
        found = [orb.detectAndCompute(_GREYS[cells], None) for cells in window.cells]
        (points_0, features_0), (points_1, features_1) = found
        if features_0 is None or features_1 is None:
            return np.zeros((0, 2)), np.zeros((0, 2))
        forth = self._nearest(features_0, features_1)
        back = {(i, j) for j, i in self._nearest(features_1, features_0)}
        pairs = sorted(set(forth) | back)
        half = 0.5 * window.cells.shape[1] - 0.5  # pixel (0, 0) of a keypoint is the first cell's centre
        p_0 = np.array([points_0[i].pt for i, _ in pairs]).reshape(-1, 2)
        p_1 = np.array([points_1[j].pt for _, j in pairs]).reshape(-1, 2)
        return (p_0 - half) * window.cell_m, (p_1 - half) * window.cell_m

    def _nearest(self, features: Array, others: Array) -> list[tuple[int, int]]:
        """Pairs that pass the ratio test."""
        pairs = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(features, others, k=2)
        return [
            (p[0].queryIdx, p[0].trainIdx)
            for p in pairs
            if len(p) == 2 and p[0].distance < self.ratio * p[1].distance
        ]
