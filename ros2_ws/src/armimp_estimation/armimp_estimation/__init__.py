"""Impedance from spectra, bags of trials, reports, and the estimator node."""
