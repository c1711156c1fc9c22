"""The robot description moves and weighs what the plant does."""

from xml.etree import ElementTree as ET

import numpy as np
import pytest
from robot_description import robot_description

from armimp_sim import presets
from armimp_sim.model.robot import PlanarChain


def numbers(element: ET.Element, path: str, attribute: str) -> list[float]:
    (found,) = element.findall(path)
    return [float(text) for text in found.attrib[attribute].split()]


def described(urdf: str, names: tuple[str, ...]) -> PlanarChain:
    """The chain of the links of a description, whose moments are about their joints."""
    root = ET.fromstring(urdf)
    parts = {one.attrib["name"]: one for kind in ("joint", "link") for one in root.iter(kind)}
    links = [parts[f"{name}_link"] for name in names]
    assert all(numbers(parts[name], "axis", "xyz") == [0.0, 0.0, 1.0] for name in names)
    masses = [numbers(one, "inertial/mass", "value")[0] for one in links]
    centres = [numbers(one, "inertial/origin", "xyz")[0] for one in links]
    about_centre = [numbers(one, "inertial/inertia", "izz")[0] for one in links]
    return PlanarChain(
        lengths=tuple(
            numbers(parts[one], "origin", "xyz")[0] for one in (*names[1:], "hand_mount")
        ),
        moments=tuple(np.add(about_centre, np.multiply(masses, np.square(centres))).tolist()),
        masses=tuple(masses),
        centres=tuple(centres),
    )


@pytest.mark.parametrize("joints", sorted(presets.JOINT_NAMES))
def test_the_inertia_of_the_description_is_that_of_the_plant(joints: int) -> None:
    theta = presets.human_arm(joints).theta_0 + 0.3
    found = described(robot_description(joints), presets.JOINT_NAMES[joints]).mass_matrix(theta)
    np.testing.assert_allclose(found, presets.robot(joints).mass_matrix(theta), rtol=1e-6)
