"""A map of surface elements for scan matching.

Each cell keeps the mean and normal of the surface points seen in it, separately for the two faces of a wall:
a point belongs only to a surface seen from its own side, or else a scan could lock on to the far face of a
0.1 m wall. Averaging over many scans makes the surface finer than the lidar's noise.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rendezvous.compiled import njit
from rendezvous.geometry.se2 import Array

# Columns of an element: mean x and y, unit normal, weight, and the length of the mean of its normals.
X, Y, NX, NY, WEIGHT, LENGTH = range(6)


class Surface(NamedTuple):
    """Surface elements in linked lists, one per cell."""

    # (N, N) int32 first element of each cell, -1 for none; the map's origin is in the middle.
    first: NDArray[np.int32]
    after: NDArray[np.int32]  # (M,) int32 next element of the same cell, -1 for none
    elements: Array  # (M, 6), see the columns above
    cell_m: float  # side of the cells
    same_side: float  # least cosine between the normals of a point and its element


class SurfaceMap:
    """A surface that grows scan by scan.

    An element of `max_weight` stops moving: the map cannot creep. One point at a sigma of 1 cm weighs 1.
    """

    def __init__(self, *, extent_m: float, cell_m: float, same_side: float, max_weight: float) -> None:
        cells = 2 * math.ceil(0.5 * extent_m / cell_m)
        self.surface = Surface(
            first=np.full((cells, cells), -1, np.int32),
            after=np.full(4096, -1, np.int32),
            elements=np.zeros((4096, 6)),
            cell_m=cell_m,
            same_side=same_side,
        )
        self._max_weight = max_weight
        self._count = 0

    def insert(self, points_m: Array, normals: Array, sigma_m: Array, pose: Array) -> None:
        """Average a scan into the map.

        Points (B, 2) are in the robot frame, normals towards the sensor; those with a normal of zero are left
        out.
        """
        surface = self.surface
        if self._count + len(points_m) > len(surface.elements):
            self.surface = surface._replace(
                elements=np.concatenate([surface.elements, np.zeros_like(surface.elements)]),
                after=np.concatenate([surface.after, np.full_like(surface.after, -1)]),
            )
        self._count = _insert(points_m, normals, sigma_m, pose, self.surface, self._count, self._max_weight)

    def cropped(self) -> Surface:
        """The surface as it is now, in as few cells as hold it."""
        surface, cell_m = self.surface, self.surface.cell_m
        elements, half = surface.elements[: self._count].copy(), surface.first.shape[0] // 2
        reach = min(math.ceil(np.abs(elements[:, :2]).max(initial=0.0) / cell_m) + 2, half)
        kept = slice(half - reach, half + reach)
        return surface._replace(
            first=surface.first[kept, kept].copy(),
            after=surface.after[: self._count].copy(),
            elements=elements,
        )


@njit
def _insert(
    points_m: Array,
    normals: Array,
    sigma_m: Array,
    pose: Array,
    surface: Surface,
    count: int,
    max_weight: float,
) -> int:
    """Average the scan's points into their cells' elements; the new number of elements."""
    first, after, elements, cell_m, same_side = surface
    c, s = math.cos(pose[2]), math.sin(pose[2])
    half = first.shape[0] // 2
    for i in range(points_m.shape[0]):
        if normals[i, 0] == 0.0 and normals[i, 1] == 0.0:
            continue
        x = pose[0] + c * points_m[i, 0] - s * points_m[i, 1]
        y = pose[1] + s * points_m[i, 0] + c * points_m[i, 1]
        nx = c * normals[i, 0] - s * normals[i, 1]
        ny = s * normals[i, 0] + c * normals[i, 1]
        row, col = math.floor(y / cell_m) + half, math.floor(x / cell_m) + half
        if not (0 <= row < first.shape[0] and 0 <= col < first.shape[1]):
            continue
        k = first[row, col]
        while k >= 0:
            e = elements[k]
            if e[NX] * nx + e[NY] * ny > same_side:
                break
            k = after[k]
        if k < 0:
            k = count
            count += 1
            after[k] = first[row, col]
            first[row, col] = k
        e = elements[k]
        # A weight of 1 is one point at a sigma of 1 cm.
        w = (0.01 / sigma_m[i]) ** 2
        if e[WEIGHT] < max_weight:
            share = w / (e[WEIGHT] + w)
            e[X] += share * (x - e[X])
            e[Y] += share * (y - e[Y])
            mean_x = (1.0 - share) * e[LENGTH] * e[NX] + share * nx
            mean_y = (1.0 - share) * e[LENGTH] * e[NY] + share * ny
            e[LENGTH] = math.sqrt(mean_x * mean_x + mean_y * mean_y)
            e[NX], e[NY] = mean_x / e[LENGTH], mean_y / e[LENGTH]
            e[WEIGHT] += w
    return count


@njit(inline="always")
def nearest(x: float, y: float, nx: float, ny: float, surface: Surface, gate_m: float) -> int:
    """The nearest element seen from the same side, -1 for none within the gate."""
    first, after, elements, cell_m, same_side = surface
    half = first.shape[0] // 2
    row, col = math.floor(y / cell_m) + half, math.floor(x / cell_m) + half
    best, best_d2 = -1, gate_m * gate_m
    for r in range(max(row - 1, 0), min(row + 2, first.shape[0])):
        for q in range(max(col - 1, 0), min(col + 2, first.shape[1])):
            k = first[r, q]
            while k >= 0:
                e = elements[k]
                dx, dy = e[X] - x, e[Y] - y
                d2 = dx * dx + dy * dy
                if d2 < best_d2 and e[NX] * nx + e[NY] * ny > same_side:
                    best, best_d2 = k, d2
                k = after[k]
    return best
