"""Two robots explore a plan by frontiers until they meet."""
