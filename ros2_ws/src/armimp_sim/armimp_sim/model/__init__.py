"""Models of the parts of the rig: arm, robot, friction, sensors."""
