"""Writes the shipped designs: ``python -m rpod_target.designs FOLDER``."""

import sys
from pathlib import Path

from rpod_target.designs import designs


def main(folder: Path) -> None:
    """Write the parameter files and mesh files of all designs into a folder."""
    for design in designs():
        design.write(folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
