"""Installation of armimp_estimation, an ordinary ament_python package."""

from glob import glob

from setuptools import find_packages, setup

NAME = "armimp_estimation"

setup(
    name=NAME,
    version="0.1.0",
    description="Impedance from spectra, bags of trials, reports, and the estimator node.",
    license="Apache-2.0",
    maintainer="armimp developers",
    maintainer_email="armimp@example.org",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={
        NAME: [
            *("py.typed", "problems.yaml", "paper.mplstyle"),
            *("report/*.css", "report/*.js", "report/templates/*.html"),
        ]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", sorted(glob("config/*.*"))),
    ],
    zip_safe=False,
    python_requires=">=3.10",
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    entry_points={"console_scripts": ["impedance_estimator = armimp_estimation.node:main"]},
)
