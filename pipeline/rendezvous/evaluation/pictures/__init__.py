"""Contact sheets and drawings of maps, plans and images."""
