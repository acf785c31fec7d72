from glob import glob

from setuptools import setup

PACKAGE = "neuse_slam_node"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=[PACKAGE, f"{PACKAGE}.adapters"],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/config", glob("config/*.yaml")),
        (f"share/{PACKAGE}/launch", glob("launch/*.launch.py")),
    ],
    install_requires=["setuptools"],
    license="Apache-2.0",
    description="Latent object codes to camera poses, keyframes and pose-graph edges",
    entry_points={"console_scripts": ["slam_node = neuse_slam_node.__main__:main"]},
)
