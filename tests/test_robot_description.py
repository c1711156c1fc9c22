"""The robot description moves and weighs what the plant does."""

from xml.etree import ElementTree as ET

import numpy as np
import pytest
from numpy.typing import NDArray
from robot_description import robot_description

from armimp_sim import presets

Vector = NDArray[np.float64]


def numbers(element: ET.Element | None, attribute: str) -> Vector:
    assert element is not None
    return np.array([float(text) for text in element.attrib[attribute].split()])


def mass_matrix(urdf: str, names: tuple[str, ...], theta: Vector) -> Vector:
    """M(θ) of the links of a description, from its velocities: Σ m JᵀJ + Izz ωᵀω."""
    root = ET.fromstring(urdf)
    joints = {joint.attrib["name"]: joint for joint in root.iter("joint")}
    links = {link.attrib["name"]: link for link in root.iter("link")}
    matrix = np.zeros((len(names), len(names)))
    pivots: list[Vector] = []
    place, angle = np.zeros(2), 0.0
    for i, name in enumerate(names):
        joint = joints[name]
        assert numbers(joint.find("axis"), "xyz").tolist() == [0.0, 0.0, 1.0]
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        place = place + turn @ numbers(joint.find("origin"), "xyz")[:2]
        pivots.append(place)
        angle += theta[i]
        child = joint.find("child")
        assert child is not None
        inertial = links[child.attrib["link"]].find("inertial")
        assert inertial is not None
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        centre = place + turn @ numbers(inertial.find("origin"), "xyz")[:2]
        mass = numbers(inertial.find("mass"), "value")[0]
        izz = numbers(inertial.find("inertia"), "izz")[0]
        jacobian = np.zeros((2, len(names)))
        for j, pivot in enumerate(pivots):
            jacobian[:, j] = [-(centre - pivot)[1], (centre - pivot)[0]]
        spin = (np.arange(len(names)) <= i).astype(float)
        matrix += mass * jacobian.T @ jacobian + izz * np.outer(spin, spin)
    return matrix


@pytest.mark.parametrize("joints", sorted(presets.JOINT_NAMES))
def test_the_inertia_of_the_description_is_that_of_the_plant(joints: int) -> None:
    theta = presets.human_arm(joints).theta_0 + 0.3

    found = mass_matrix(robot_description(joints), presets.JOINT_NAMES[joints], theta)

    np.testing.assert_allclose(found, presets.robot(joints).mass_matrix(theta), rtol=1e-6)
