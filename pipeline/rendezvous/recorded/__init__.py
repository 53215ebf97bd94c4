"""Recorded laser logs: one record for all formats, maps of their stretches, error against a reference."""
