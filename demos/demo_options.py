"""The options that all demos share: where results go, which of them, whether an interrupted run goes on."""

import argparse
from pathlib import Path

__all__ = ["add_options"]


def add_options(parser: argparse.ArgumentParser, name: str, figure: int) -> None:
    """Add --output, --no-figure, --paraview and --checkpoint to the options of the demo `name` with the figure `figure`."""
    add = parser.add_argument
    add("--output", type=Path, default=Path("results") / name, help="folder for the results (%(default)s)")
    add("--no-figure", action="store_true", help=f"skip figure{figure}.png")
    add("--paraview", action="store_true", help="write .bp series")
    add("--checkpoint", action="store_true", help="save every step, and go on from the last one saved in the folder")
