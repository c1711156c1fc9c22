"""Installation of armimp_ros2_control, an ordinary ament_python package."""

from glob import glob

from setuptools import find_packages, setup

NAME = "armimp_ros2_control"

setup(
    name=NAME,
    version="0.1.0",
    description="Bridge between the graph of armimp and a robot that ros2_control drives.",
    license="Apache-2.0",
    maintainer="armimp developers",
    maintainer_email="armimp@example.org",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", sorted(glob("config/*.*"))),
    ],
    zip_safe=False,
    python_requires=">=3.10",
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    entry_points={"console_scripts": ["ros2_control_bridge = armimp_ros2_control.node:main"]},
)
