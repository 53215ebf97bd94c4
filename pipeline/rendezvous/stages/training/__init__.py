"""What the two training stages share, and the fit of their confidence."""
