"""Estimators of the impedance matrix."""
