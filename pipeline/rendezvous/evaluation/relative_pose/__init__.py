"""How well relative poses are read from images: the report's part and its figures."""
