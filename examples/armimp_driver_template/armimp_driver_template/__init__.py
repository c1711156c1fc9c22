"""Template of a driver: copy the package, replace the mock by the device, keep the rest."""
