"""Write pairs, images and plans in the formats of other programs."""
