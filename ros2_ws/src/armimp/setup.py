"""Installation of armimp, an ordinary ament_python package."""

from setuptools import find_packages, setup

NAME = "armimp"

setup(
    name=NAME,
    version="0.1.0",
    description="Impedance of a human arm from arrays, bags or simulations, without ROS.",
    license="Apache-2.0",
    maintainer="armimp developers",
    maintainer_email="armimp@example.org",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    zip_safe=False,
    python_requires=">=3.10",
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
)
