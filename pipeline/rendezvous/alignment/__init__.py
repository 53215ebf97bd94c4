"""The frame error, the window in which both maps lie, and what an estimator answers."""
