"""Installation of armimp_bringup, an ordinary ament_python package."""

from glob import glob

from setuptools import find_packages, setup

NAME = "armimp_bringup"

setup(
    name=NAME,
    version="0.1.0",
    description="Orchestrator of the node graph, study runner and the armimp command line.",
    license="Apache-2.0",
    maintainer="armimp developers",
    maintainer_email="armimp@example.org",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "*.xml", "study/templates/*.html"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", sorted(glob("config/*.*"))),
        (f"share/{NAME}/layouts", sorted(glob("layouts/*.*"))),
    ],
    zip_safe=False,
    python_requires=">=3.10",
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"], "dask": ["distributed"]},
    entry_points={"console_scripts": ["armimp = armimp_bringup.cli:program"]},
)
