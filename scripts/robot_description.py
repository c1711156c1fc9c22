"""The rig as a robot description (URDF), for robot_state_publisher, viewers and simulators.

The planar chain lies in the x-y plane, and every joint turns about z. At the angles zero all links
point along x. Joints have the names of ``joint_states``, so that its angles move the description.

Of the inertia of a link, the plane knows mass, centre and the moment about z alone. The other two
moments are set equal to that one, which a rigid body can have. The arm has shapes but no inertia:
M_h need not be symmetric, and no rigid body has such an inertia.
"""

from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np

from armimp_sim import presets
from armimp_sim.model.robot import PlanarChain

_TUBE = 0.015
"""Radius of the drawn links (m)."""
_MOTOR = (0.03, 0.06)
"""Radius and height of the drawn joints (m)."""
_FLESH = (0.045, 0.035)
"""Radius of the drawn arm at the first and at the last segment (m)."""
_BELOW = -0.05
"""Height of the exoskeleton under the arm, which lies in the plane z = 0 (m)."""
_COLOURS = {"steel": "0.35 0.38 0.42 1", "motor": "0.15 0.15 0.17 1", "skin": "0.87 0.67 0.55 0.8"}


def robot_description(joints: int) -> str:
    """Return the URDF of the preset rig with this number of joints, 1 to 7."""
    chain = presets.robot(joints)
    names = presets.JOINT_NAMES[joints]
    root = ET.Element("robot", name=f"armimp_{joints}_joints")
    for name, rgba in _COLOURS.items():
        ET.SubElement(ET.SubElement(root, "material", name=name), "color", rgba=rgba)
    base = ET.SubElement(root, "link", name="base_link")
    _cylinder(base, radius=_MOTOR[0] * 1.5, length=_MOTOR[1], z=_BELOW, material="motor")
    parent, reach = "base_link", 0.0
    for i, name in enumerate(names):
        length = float(chain.lengths[i])
        link = ET.SubElement(root, "link", name=f"{name}_link")
        _inertial(link, chain, i)
        _cylinder(link, radius=_MOTOR[0], length=_MOTOR[1], z=_BELOW, material="motor")
        _cylinder(link, radius=_TUBE, length=length, x=length / 2, z=_BELOW, material="steel")
        _joint(root, name, "continuous", parent, f"{name}_link", reach)
        arm = ET.SubElement(root, "link", name=f"{name}_arm")
        flesh = float(np.interp(i, (0, max(joints - 1, 1)), _FLESH))
        _cylinder(arm, radius=flesh, length=length, x=length / 2, material="skin")
        _joint(root, f"{name}_strap", "fixed", f"{name}_link", f"{name}_arm", 0.0)
        parent, reach = f"{name}_link", length
    ET.SubElement(root, "link", name="hand")
    _joint(root, "hand_mount", "fixed", parent, "hand", reach)
    ET.indent(root)
    return f'<?xml version="1.0"?>\n{ET.tostring(root, encoding="unicode")}\n'


def _inertial(link: ET.Element, chain: PlanarChain, i: int) -> None:
    """Mass, centre and moments of a link about its centre: Izz = I - m·lg²."""
    moment, mass, centre = float(chain.moments[i]), float(chain.masses[i]), float(chain.centres[i])
    if mass == 0.0:
        # Only the moment of the first link matters, but simulators want a mass. A thin rod of this
        # length and moment, I = m·l²/3, moves alike.
        centre = float(chain.lengths[i]) / 2
        mass = moment / (4 * centre**2 / 3)
    about_centre = f"{moment - mass * centre**2:.9g}"
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=f"{centre:.9g} 0 0", rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=f"{mass:.9g}")
    moments = {"ixx": about_centre, "iyy": about_centre, "izz": about_centre}
    ET.SubElement(inertial, "inertia", {**moments, "ixy": "0", "ixz": "0", "iyz": "0"})


def _cylinder(
    link: ET.Element,
    *,
    radius: float,
    length: float,
    x: float | None = None,
    z: float = 0.0,
    material: str,
) -> None:
    """Draw a cylinder: upright, or lying along x if it is given a centre there."""
    visual = ET.SubElement(link, "visual")
    rpy = "0 0 0" if x is None else f"0 {np.pi / 2:.9g} 0"
    ET.SubElement(visual, "origin", xyz=f"{x or 0.0:.9g} 0 {z:.9g}", rpy=rpy)
    shape = ET.SubElement(visual, "geometry")
    ET.SubElement(shape, "cylinder", radius=f"{radius:.9g}", length=f"{length:.9g}")
    ET.SubElement(visual, "material", name=material)


def _joint(root: ET.Element, name: str, kind: str, parent: str, child: str, x: float) -> None:
    joint = ET.SubElement(root, "joint", name=name, type=kind)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    ET.SubElement(joint, "origin", xyz=f"{x:.9g} 0 0", rpy="0 0 0")
    if kind != "fixed":
        ET.SubElement(joint, "axis", xyz="0 0 1")
