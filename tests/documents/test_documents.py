"""Every code block of every document is run, in its order, in an empty folder for each document.

How a document has a block treated otherwise stands in ``blocks``, and for authors in CONTRIBUTING.md.
"""

import doctest
import fcntl
import importlib
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from blocks import blocks_of
from playground import PRINTED, ROOT, RUN_S, Playground, commands

from rpod_site.documents import tracked

DOCUMENTS = [document for document in tracked(ROOT) if any(blocks_of(ROOT / document))]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
LEFT_OUT = [
    block for document in DOCUMENTS for block in blocks_of(ROOT / document) if block.kind == "not run"
]
ELSEWHERE = re.compile(r"(\S+\.md) has (the same|such)(?: a)? commands?")
SOURCES = [
    (room, file) for room in ("schemas", "services", "sim_sensor") for file in (ROOT / room).rglob("*.py")
]
WITH_EXAMPLES = [
    ".".join(file.relative_to(ROOT / room).with_suffix("").parts)
    for room, file in SOURCES
    if ">>>" in file.read_text("utf-8")
]
"""Modules whose docstrings have examples, which the site shows."""
LONGEST_README = 700


@pytest.fixture(scope="module")
def log_of(tmp_path_factory) -> Callable[[str], Path]:
    """Return the log of a short run of a scenario, made once for all workers."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "logs"
    folder.mkdir(exist_ok=True)

    def made(scenario: str) -> Path:
        with (folder / f"{scenario}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # another worker may play it
            done = folder / scenario
            if not done.exists():
                out = tempfile.mkdtemp(dir=folder)
                options = ["--duration", f"{RUN_S:g}", "--speed", "max", "--out", out]
                command = [sys.executable, "-m", "rpod", "run", scenario, *options]
                ended = subprocess.run(command, check=True, capture_output=True, text=True, timeout=240.0)
                Path(out, PRINTED).write_text(ended.stdout, "utf-8")
                Path(out).rename(done)
            return next(done.glob(f"*/{scenario}.mcap"))

    return made


@pytest.mark.timeout(600)
@pytest.mark.parametrize("document", DOCUMENTS, ids=str)
def test_the_blocks_of_a_document_run(document, tmp_path, log_of):
    with closing(Playground(tmp_path, log_of)) as playground:
        for block in blocks_of(ROOT / document):
            playground.take(block)
    shutil.rmtree(tmp_path, ignore_errors=True)


@pytest.mark.parametrize("block", LEFT_OUT, ids=str)
def test_a_block_that_another_place_runs_is_run_there(block):
    for test in re.findall(r"\btests/\S+\.py\b", block.said):
        assert (ROOT / test).is_file(), block.said
    if found := ELSEWHERE.fullmatch(block.said):
        run = [other for other in blocks_of(ROOT / found[1]) if other.language == "sh"]
        there = [command for other in run if other.kind != "not run" for command in commands(other.text)]
        for command in commands(block.text):
            assert any(
                is_such(other, command) and (found[2] != "the same" or bare(other) == bare(command))
                for other in there
            ), command


def test_a_command_is_such_as_another_by_its_verb_and_its_options():
    assert is_such("rpod campaign pmd-sun --seed 7 --trials 2", ".venv/bin/rpod campaign pmd-sun --seed 1")
    assert not is_such("rpod campaign pmd-sun --seed 7", "rpod campaign pmd-sun --trials 2")
    assert not is_such("rpod replay run.mcap", "rpod recover run.mcap")


def bare(command: str) -> list[str]:
    """Return the words of a command, the program without its folder."""
    program, *words = command.split()
    return [Path(program).name, *words]


def is_such(other: str, command: str) -> bool:
    """Return whether a command has the verb of another one, and at least its options."""
    verbs, options = zip(*(_verb_and_options(bare(each)) for each in (other, command)), strict=True)
    return bool(verbs[0] == verbs[1] and options[0] >= options[1])


def _verb_and_options(words: list[str]) -> tuple[list[str], set[str]]:
    verb = list(itertools.takewhile(re.compile(r"[a-z-]*[a-z]").fullmatch, words))
    return verb, {word for word in words if word.startswith("--")}


@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_the_examples_of_docstrings_give_what_they_show(module):
    ended = doctest.testmod(importlib.import_module(module))
    assert ended.attempted > 0
    assert ended.failed == 0


def test_every_make_target_named_in_a_sentence_is_one():
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    named = {
        (name, str(document))
        for document in tracked(ROOT)
        for name in re.findall(r"`make ([a-z-]+)", (ROOT / document).read_text("utf-8"))
    }
    assert {"run", "test", "check"} <= {name for name, _ in named}
    assert [each for each in sorted(named) if each[0] not in targets] == []


def test_the_readme_is_short():
    words = (ROOT / "README.md").read_text("utf-8").split()
    assert len(words) <= LONGEST_README


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda file: file.name)
def test_a_notebook_is_kept_without_outputs(notebook):
    cells = json.loads(notebook.read_text("utf-8"))["cells"]
    assert all(not cell.get("outputs") and cell.get("execution_count") is None for cell in cells)
