from glob import glob

from setuptools import setup

PACKAGE = "neuse_mapper_node"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=[PACKAGE],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/config", glob("config/*")),
    ],
    install_requires=["setuptools"],
    license="Apache-2.0",
    description="Tracked frames to a change-aware object map, its changes and markers",
    entry_points={"console_scripts": ["mapper_node = neuse_mapper_node.__main__:main"]},
)
