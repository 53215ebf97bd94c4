"""Draws scenes by tracing paths of light, with Blender's Cycles."""
