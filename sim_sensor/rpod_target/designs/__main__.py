"""Writes the shipped designs: ``python -m rpod_target.designs FOLDER``."""

from argparse import ArgumentParser
from pathlib import Path

from rpod_target.designs import designs

if __name__ == "__main__":
    parser = ArgumentParser(prog="python -m rpod_target.designs", description="Write the shipped designs.")
    parser.add_argument("folder", type=Path, help="folder of the parameter files")
    folder: Path = parser.parse_args().folder
    for design in designs():
        design.write(folder)
