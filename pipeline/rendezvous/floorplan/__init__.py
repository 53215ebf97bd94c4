"""Read, generate, validate and furnish floor plans; raise their walls."""
