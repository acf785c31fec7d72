"""Entry point of `ros2 run neuse_slam_node slam_node`."""

import sys

from neuse_encoder_node.start import start


def main() -> None:
    """Run the node."""
    sys.exit(start("neuse_slam_node.node"))


if __name__ == "__main__":
    main()
