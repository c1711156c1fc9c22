"""Simulated arm in a simulated exoskeleton: plant, sensors and the node that serves them."""
