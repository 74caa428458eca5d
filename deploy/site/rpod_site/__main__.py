"""``python -m rpod_site`` builds the site into ``build/site/html``; a warning is an error."""

import argparse
import shutil
import subprocess
import sys
from pathlib import Path

from rpod_site import api, command_line, configuration, documents, faults, navigation, notebooks, offline

ROOT = Path(__file__).parents[3]
ASSETS = ROOT / "deploy" / "site" / "assets"
BUILD = ROOT / "build" / "site"


def main() -> int:
    """Stage the pages, build the site, and check that it needs no network; return the exit code."""
    parser = argparse.ArgumentParser(prog="rpod_site", description=__doc__)
    parser.add_argument("--without-notebooks", action="store_true", help="Show notebooks without outputs.")
    stage(execute=not parser.parse_args().without_notebooks)
    if not build():
        return 1
    outside = offline.make(BUILD / "html", ASSETS / "iframe-worker.js")
    for page, address in outside:
        print(f"{page}: loads {address}; a page of the site loads nothing from a network", file=sys.stderr)
    searchable = offline.is_searchable(BUILD / "html")
    if not searchable:
        print(
            "the site has no index that a page from a disk can search: see the plugin offline",
            file=sys.stderr,
        )
    print(f"site     {BUILD / 'html' / 'index.html'}")
    return 1 if outside or not searchable else 0


def stage(*, execute: bool) -> None:
    """Write all pages, and the configuration of the site beside them."""
    pages = BUILD / "pages"
    reference = pages / "docs" / "reference"
    shutil.rmtree(BUILD, ignore_errors=True)
    documents.stage(ROOT, pages)
    notebooks.stage(ROOT, pages, execute=execute)
    api.write(ROOT, reference / "api")
    configuration.write(reference / "configuration")
    command_line.write(reference / "command-line.md")
    faults.write(reference / "faults.md")
    shutil.copy(ASSETS / "site.css", pages)
    navigation.write(ASSETS.parent / "mkdocs.yml", BUILD / "mkdocs.yml", pages)


def build() -> bool:
    """Build the site; return whether there was no warning. Each warning goes to standard error."""
    command = ["-m", "properdocs", "build", "--strict", "--config-file", str(BUILD / "mkdocs.yml")]
    # Not with --quiet, which hides warnings from --strict too.
    built = subprocess.run([sys.executable, *command], stderr=subprocess.PIPE, text=True, check=False)
    if built.returncode:
        sys.stderr.writelines(line for line in built.stderr.splitlines(keepends=True) if "INFO" not in line)
    return not built.returncode


if __name__ == "__main__":
    sys.exit(main())
