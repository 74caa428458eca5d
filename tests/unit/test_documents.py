"""What a document links to, or names as a path in code quotes, is there."""

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted(
    name
    for name in subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", "*.md"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()
    if (ROOT / name).exists()
)
LINK = re.compile(r"\]\(([^)\s]+)\)")
CODE = re.compile(r"`([^`\s]+)`")
FILE = re.compile(r"(?:[\w.-]+/)+[\w.-]+\.(?:md|py|json|yaml|yml|toml|sh|ts|txt|msg|j2)|[\w-]+\.md")
ROOMS = ("", "schemas", "services", "sim_sensor", "schemas/rpod_schemas", "sim_sensor/rpod_target")
"""Folders that a path may start from: the document's own, these, and any package of the services."""
MADE = re.compile(r"^(runs|config|out)/|NNNN|[<*]|^src/my_distance/")
"""Paths of what a run writes, or what a reader of a how-to does, and patterns."""


def cited(text):
    links = [link.split("#")[0] for link in LINK.findall(text)]
    code = [name for name in CODE.findall(text) if FILE.fullmatch(name) and not MADE.search(name)]
    return [link for link in links if link and "://" not in link and not link.startswith("mailto:")], code


@pytest.mark.parametrize("document", DOCUMENTS)
def test_what_a_document_cites_is_there(document):
    path = ROOT / document
    links, code = cited(path.read_text("utf-8"))
    missing = [link for link in links if not (path.parent / link).exists()]
    starts = [path.parent, *(ROOT / room for room in ROOMS), *(ROOT / "services").glob("rpod*")]
    missing += [name for name in code if not any((start / name).exists() for start in starts)]
    assert not missing


def test_a_citation_of_nothing_is_found():
    links, code = cited(
        "See [that](docs/none.md#x), [this](https://a.b/c.md) and `findings/bus.md`, `runs/x/report.md`."
    )
    assert links == ["docs/none.md"]
    assert code == ["findings/bus.md"]


TRIED = (ROOT / "docs/results/drivers.md").read_text("utf-8").split("| tried |")[1]
ROWS = [line for line in TRIED.splitlines()[2:] if line.startswith("| ")]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.split("|")[1].strip()[:40])
def test_each_input_that_was_tried_has_a_test_that_is_there(row):
    named = re.fullmatch(r"`([\w/]+\.py)::(test_\w+)`", row.split("|")[-2].strip())
    assert named, "the last column names the test"
    assert re.search(rf"^def {named[2]}\(", (ROOT / "tests" / named[1]).read_text("utf-8"), re.MULTILINE)


def test_all_inputs_that_were_tried_are_read():
    assert len(ROWS) >= 19
