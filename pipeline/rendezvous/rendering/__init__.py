"""Pictures of furnished floor plans with a robot in them, and what is known about every pixel."""
