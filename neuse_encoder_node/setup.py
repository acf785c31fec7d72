from glob import glob

from setuptools import setup

PACKAGE = "neuse_encoder_node"

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=[PACKAGE],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/config", glob("config/*.yaml")),
    ],
    install_requires=["setuptools"],
    license="Apache-2.0",
    description="Segmented RGB-D images to latent object codes",
    entry_points={"console_scripts": ["encoder_node = neuse_encoder_node.__main__:main"]},
)
