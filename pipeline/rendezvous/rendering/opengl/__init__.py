"""Draws scenes without a screen, through pyrender's context."""
