from setuptools import setup

COMMANDS = ("simulate", "convert", "info", "play", "record", "run", "evaluate", "view", "demo", "bench")

setup(
    name="neuse_bags",
    version="0.1.0",
    packages=["neuse_bags"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/neuse_bags"]),
        ("share/neuse_bags", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    license="Apache-2.0",
    description="Bags for NeuSE: simulate, convert, play, record, run the in-process pipeline, evaluate",
    entry_points={"console_scripts": [f"{command} = neuse_bags.commands:{command}" for command in COMMANDS]},
)
