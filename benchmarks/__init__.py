"""Benchmarks for the development of the project, run from the checkout: ``make bench``."""
