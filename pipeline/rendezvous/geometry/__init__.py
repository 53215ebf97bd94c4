"""The shared language: SE(2), cameras, cuboids, occupancy grids."""
