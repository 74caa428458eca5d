"""Writes the bill of materials and the list of licences from the lock file (run by ``make lock``).

The components with their hashes are what cyclonedx-py reads in the lock; licences are what the installed
packages state. Addresses of registries are left out: they differ between laboratories with mirrors.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent
LOCK, SBOM, LICENCES = (FOLDER / name for name in ("requirements.lock", "sbom.cdx.json", "licences.csv"))
_NOT_HERE = "not installed where this list was made"


def components() -> dict[str, Any]:
    """Return the document that cyclonedx-py makes of the lock."""
    made = subprocess.run(
        [sys.executable, "-m", "cyclonedx_py", "requirements", str(LOCK), "--output-reproducible",
         "--short-PURLs", "--sv", "1.6", "--pyproject", str(FOLDER.parents[1] / "pyproject.toml"),
         "--mc-type", "library"],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    document: dict[str, Any] = json.loads(made.stdout)
    return document


def licences(names: list[str]) -> dict[str, str]:
    """Return the licence that each installed package states, by its normalised name."""
    made = subprocess.run(
        [sys.executable, "-m", "piplicenses", "--from=mixed", "--format=json", "--packages", *names],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    return {_normal(each["Name"]): each["License"].strip().split("\n")[0] for each in json.loads(made.stdout)}


def _normal(name: str) -> str:
    return name.lower().replace("_", "-").replace(".", "-")


def main() -> None:
    """Write both files."""
    document = components()
    document["metadata"].pop("tools", None)
    stated = licences([each["name"] for each in document["components"]])
    lines = ["name,version,licence"]
    for each in document["components"]:
        licence = stated.get(_normal(each["name"]), _NOT_HERE)
        each.pop("description", None)
        each["licenses"] = [{"license": {"name": licence}}]
        for reference in each["externalReferences"]:
            reference.pop("comment", None)
            reference["url"] = each["purl"]
        lines.append(f'{each["name"]},{each["version"]},"{licence}"')
    SBOM.write_text(json.dumps(document, indent=1) + "\n", "utf-8")
    LICENCES.write_text("\n".join(lines) + "\n", "utf-8")


main()
