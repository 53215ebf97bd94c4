"""From belief maps to a relative pose with its covariance; DOPE's labels."""
