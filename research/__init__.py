"""Monte Carlo studies of our own that answer one question each; run from the checkout."""
