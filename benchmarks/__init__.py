"""Benchmarks of our own, run from the checkout: ``make bench``."""
