"""Images of furnished floor plans with a robot in them, and labels of every pixel."""
