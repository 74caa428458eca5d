"""``python -m rpod_site`` builds the site into ``build/site/html``; a warning is an error."""

import argparse
import os
import shutil
import subprocess
import sys
from pathlib import Path

from rpod_site import api, command_line, configuration, documents, navigation, notebooks, offline

ROOT = Path(__file__).parents[3]
BUILD = ROOT / "build" / "site"


def main() -> int:
    """Stage the pages, build the site, and check that it needs no network; return the exit code."""
    parser = argparse.ArgumentParser(prog="rpod_site", description=__doc__)
    parser.add_argument(
        "--without-notebooks", action="store_true", help="Show notebooks without their outputs."
    )
    arguments = parser.parse_args()
    pages = BUILD / "pages"
    shutil.rmtree(BUILD, ignore_errors=True)
    documents.stage(ROOT, pages)
    notebooks.stage(ROOT, pages, execute=not arguments.without_notebooks)
    reference = pages / "docs" / "reference"
    api.write(ROOT, reference / "api")
    configuration.write(reference / "configuration")
    command_line.write(reference / "command-line.md")
    shutil.copy(ROOT / "deploy" / "site" / "assets" / "site.css", pages)
    navigation.write(ROOT / "deploy" / "site" / "mkdocs.yml", BUILD / "mkdocs.yml", pages)
    # Material prints a notice of its own end of life at every build: see decision 16.
    quiet = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    # Not with --quiet, which hides warnings from --strict too.
    command = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "--config-file",
        str(BUILD / "mkdocs.yml"),
    ]
    built = subprocess.run(command, env=quiet, stderr=subprocess.PIPE, text=True, check=False)
    if built.returncode:
        sys.stderr.writelines(line for line in built.stderr.splitlines(keepends=True) if "INFO" not in line)
        return built.returncode
    outside = offline.make(BUILD / "html", ROOT / "deploy" / "site" / "assets" / "iframe-worker.js")
    for page, address in outside:
        print(f"{page}: loads {address}; a page of the site loads nothing from a network", file=sys.stderr)
    print(f"site     {BUILD / 'html' / 'index.html'}")
    return 1 if outside else 0


if __name__ == "__main__":
    sys.exit(main())
