"""Measure a frame-error estimator of your own beside shipped ones: phase correlation of the walls.

It finds shifts and no rotation. The report is written to the folder `report`.
"""

import sys

from skimage.registration import phase_cross_correlation

import rendezvous
from rendezvous import SE2, Estimate
from rendezvous.alignment.window import OCCUPIED_CELL, MapWindow


class PhaseCorrelation:
    """The shift between the walls of both maps, at the peak of their phase correlation."""

    name = "phase-correlation"

    def __call__(self, window: MapWindow) -> Estimate:
        """The frame error θ: map 1 lies θ away from where it should."""
        walls_0, walls_1 = (cells == OCCUPIED_CELL for cells in window.cells)  # row grows with y, col with x
        if not (walls_0.any() and walls_1.any()):
            return Estimate(theta=None, reason="a map without walls")
        (rows, cols), _, _ = phase_cross_correlation(walls_0.astype(float), walls_1.astype(float))
        return Estimate(theta=SE2(-cols * window.cell_m, -rows * window.cell_m, 0.0))


if __name__ == "__main__":
    outcomes = rendezvous.evaluate(
        sys.argv[1] if len(sys.argv) > 1 else "data/dataset",
        methods={"phase-correlation": PhaseCorrelation},
        beside=["identity", "correlative"],
        yaw_range_deg=5.0,
    )
    print(outcomes.groupby("method", observed=True)[["position_m", "heading_rad", "success"]].mean())
    print("report/index.html")
