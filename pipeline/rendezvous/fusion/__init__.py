"""Two maps and a sighting become one map, with a verdict: the paper's Eq. 2 and 3, and Algorithm 1."""
