"""Look at bags in Rerun: camera, depth, colour, codes, objects as meshes, pose graph, changes over time.

Give the bag that was played and the recording of what the nodes, or `run`, made of it:

    neuse_bags view tabletop.mcap out/demo/recording.mcap

Without --out the viewer opens, with it a file is written for `rerun X.rrd`. Needs the package rerun-sdk.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from tqdm import tqdm

from neuse.errors import BagError, InputError, NeuseError, ParamError
from neuse_bags.cli import add_namespace, command_parser, run_command, stop_on_signal
from neuse_bags.mcap_file import BagReader

APPLICATION = "neuse"


def view(args: argparse.Namespace) -> None:
    """The command."""
    if args.out is not None and args.out.suffix != ".rrd":
        raise ParamError(f"--out {args.out}: the name of a Rerun file ends in .rrd; rename it")
    scenes = _scenes()
    recording = _open(scenes, args.out)
    drawn = draw_bags(scenes.RerunScene(recording), args.bags, args.namespace)
    if not drawn:
        raise BagError(f"{args.bags[0]} has nothing to look at; it needs images or what the nodes publish")
    recording.flush()
    print(f"{args.out or 'viewer'}: {sum(drawn.values())} messages of {len(drawn)} topics")


def draw_bags(scene: Any, paths: Sequence[Path], namespace: str = "") -> Counter[str]:
    """Draw what the bags have; returns how many messages of each topic."""
    drawn: Counter[str] = Counter()
    with stop_on_signal() as stop:
        for path in paths:
            with BagReader(path, namespace) as bag:
                total = sum(bag.topics[name].n_messages for name in scene.topics if name in bag.topics)
                for message in tqdm(bag.messages(scene.topics), total=total, unit="message"):
                    try:
                        scene.add(message)
                        drawn[message.topic] += 1
                    except InputError as error:
                        print(f"view: {message.topic}: {error}", file=sys.stderr)
                    if stop.is_set():
                        raise KeyboardInterrupt
    return drawn


def _scenes() -> ModuleType:
    """What draws; it cannot be imported without Rerun."""
    try:
        return import_module("neuse_bags.rerun_scene")
    except ImportError as error:
        if (error.name or "").split(".")[0] not in ("rerun", "rerun_bindings"):
            raise
        raise NeuseError("rerun-sdk is not installed; get it: pip install '.[view]'") from error


def _open(scenes: ModuleType, out: Path | None) -> Any:
    """A recording into a file, or into a viewer that is started."""
    recording = scenes.rr.RecordingStream(APPLICATION)
    if out is None:
        try:
            recording.spawn(default_blueprint=scenes.blueprint())
        except RuntimeError as error:
            told = (
                f"the viewer cannot be started: {str(error).splitlines()[0] if str(error) else 'no reason'}"
            )
            raise NeuseError(f"{told}; write a file instead: --out X.rrd") from error
    else:
        out.parent.mkdir(parents=True, exist_ok=True)
        recording.save(out, default_blueprint=scenes.blueprint())
    return recording


def parser() -> argparse.ArgumentParser:
    """Arguments of the command."""
    made = command_parser("view", __doc__)
    made.add_argument("bags", type=Path, nargs="+", metavar="BAG", help=".mcap files or rosbag2 folders")
    made.add_argument("--out", type=Path, metavar="X.rrd", help="file to write instead of opening the viewer")
    add_namespace(made)
    return made


def main(argv: list[str] | None = None) -> int:
    """Entry point."""
    return run_command(parser(), view, argv)
