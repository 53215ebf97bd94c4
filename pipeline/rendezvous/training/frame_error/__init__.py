"""Samples of map pairs: frame errors, map defects, batches."""
