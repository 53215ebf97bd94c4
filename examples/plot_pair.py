"""Draw the walls of both maps of the first test pair, aligned by its label, to `pair.png`."""

import sys
from pathlib import Path

import matplotlib
import pyarrow.parquet as pq

from rendezvous.geometry.occupancy_grid import grid_from_png
from rendezvous.schema import PAIRS

matplotlib.use("Agg")
import matplotlib.pyplot as plt

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "data/dataset")
row = PAIRS.rows(pq.read_table(next((folder / "pairs").glob("test-*.parquet"))))[0]
grid_0, grid_1 = (
    grid_from_png(row[f"map_{i}"], resolution_m=row["resolution_m"], T_m_g=row[f"origin_{i}"]) for i in (0, 1)
)
T_m0_m1 = row["T_m0_m1_local"]
p0_m0 = grid_0.cell_centres(grid_0.occupied())  # (N, 2) [m]
p1_m0 = T_m0_m1 @ grid_1.cell_centres(grid_1.occupied())
r0, r1 = row["T_m0_r0"], T_m0_m1 @ row["T_m1_r1"]

figure, axes = plt.subplots(figsize=(6, 6), layout="constrained")
axes.scatter(*p0_m0.T, s=2, color="tab:red", label="map 0")
axes.scatter(*p1_m0.T, s=2, color="tab:blue", label="map 1")
axes.plot([r0.x_m, r1.x_m], [r0.y_m, r1.y_m], "k--o", markersize=4, label="robot 0 sees robot 1")
axes.set(aspect="equal", xlabel="x in map 0 [m]", ylabel="y in map 0 [m]", title=row["pair_id"])
axes.legend()
figure.savefig("pair.png", dpi=120)
print(f"{row['pair_id']}: overlap {row['overlap']:.2f}, range {row['range_m']:.2f} m: pair.png")
