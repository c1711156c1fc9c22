"""Template of a driver: copy the package, replace the mock by your device, keep the rest."""
