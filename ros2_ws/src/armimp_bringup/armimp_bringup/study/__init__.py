"""The paper's study: every combination of friction, resolution and perturbation, without ROS."""
