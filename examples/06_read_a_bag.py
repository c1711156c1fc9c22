"""Read the bag of a trial with the rosbags library alone; nothing of armimp is needed.

.venv/bin/python examples/06_read_a_bag.py results/example/bags/trial_1_joint_1
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rosbags.highlevel import AnyReader

bag = Path(sys.argv[1])
with AnyReader([bag]) as reader:
    for connection in sorted(reader.connections, key=lambda one: one.topic):
        print(f"{connection.msgcount:6d} {connection.msgtype:37s} {connection.topic}")

    def read(topic: str) -> tuple[Any, list[Any]]:
        """Stamps (s) and messages of a topic."""
        wanted = [one for one in reader.connections if one.topic == topic]
        found: list[Any] = [
            reader.deserialize(raw, one.msgtype) for one, _, raw in reader.messages(wanted)
        ]
        stamps = [one.header.stamp.sec + 1e-9 * one.header.stamp.nanosec for one in found]
        return np.array(stamps), found

    stamps, states = read("/joint_states")
    during, perturbation = read("/imbic_controller/perturbation")

# The bag begins before its trial, which lasts as long as a joint is perturbed.
perturbed = during[[bool(np.any(one.effort)) for one in perturbation]]
inside = (stamps >= perturbed[0]) & (stamps <= perturbed[-1])
names = states[0].name  # match joints by name: the order is free
theta = np.array([one.position for one in states])[inside].T  # (joints, samples), rad
print(f"{theta.shape[1]} samples from {stamps[inside][0]:.3f} s to {stamps[inside][-1]:.3f} s")
for name, row in zip(names, theta, strict=True):
    print(f"{name}: mean {np.degrees(row.mean()):.3f}°, rms motion {1e3 * row.std():.3f} mrad")

# What a run stores about itself is JSON in the bag's metadata (docs/interfaces.md, section 11).
information = yaml.safe_load((bag / "metadata.yaml").read_text(encoding="utf-8"))
stored = information["rosbag2_bagfile_information"]["custom_data"]
experiment = json.loads(stored["config"])["experiment"]
print(f"seed {stored['seed']}, friction level {experiment['friction']}")
print("true K:", json.loads(stored["truth"])["K"], "N·m/rad")
