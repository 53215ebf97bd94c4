"""Fuse the two maps of the shipped sighting, and write the fused map to the folder `fused`."""

from rendezvous import fuse
from rendezvous.resources import SIGHTING

result = fuse(
    SIGHTING / "map0.yaml",
    SIGHTING / "map1.yaml",
    pose0=(-2.6893, -0.203472, 2.46686),  # x [m], y [m], yaw [rad] of robot 0 in its own map
    pose1=(0.820088, 1.83098, 2.50401),
    image=SIGHTING / "image.jpg",
    camera=SIGHTING / "camera.yaml",
    out="fused",
)
print(f"map 1 in map 0: {result.T_m0_m1}")
print(f"verdict: {result.verdict}")
rows, columns = result.grid.cells.shape
print(f"fused map: {columns} x {rows} cells of {result.grid.resolution_m} m")
