"""Parts of the two training stages, and the calibration of trained networks."""
