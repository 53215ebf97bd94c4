"""Classical estimators of the frame error: none, Hough spectrum, ORB, correlative search."""
