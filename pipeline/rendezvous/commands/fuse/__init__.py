"""Two maps and a sighting become one map: the command and its Python call."""
