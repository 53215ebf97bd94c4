"""Measure trained and classical methods; write the report."""
