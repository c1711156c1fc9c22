"""Impedance of a human arm from arrays, bags or simulations, without ROS.

Examples
--------
Arrays of another rig, one trial for each joint::

    import numpy as np
    import armimp

    data = np.load("recording.npz")  # each of shape (trials, joints, samples)
    recording = armimp.Recording.from_arrays(
        data["perturbation"], data["position"], data["torque"], rate=1000.0
    )
    result = armimp.identify(recording)
    low, high = result.interval("K")  # with 95 % confidence, N·m/rad
    print(result.K, low, high)
    print("valid" if result.valid else result.problems)
"""

from armimp.facade import Recording, Result, identify, read_bag, simulate
from armimp_common.errors import ArmimpError
from armimp_estimation.fit import Calibration

__all__ = ["ArmimpError", "Calibration", "Recording", "Result", "identify", "read_bag", "simulate"]
