"""Monte Carlo studies that answer one question each; run from the checkout."""
