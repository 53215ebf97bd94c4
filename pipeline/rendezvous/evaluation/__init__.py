"""Errors and their statistics, figures, cards and the report."""
