"""Materials, textures and light, drawn at random."""
