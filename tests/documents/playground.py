"""A folder in which the blocks of one document run, in their order."""

import ast
import contextlib
import doctest
import io
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from blocks import Block
from facility_process import Lines

from rpod_runtime.bus.session import free_endpoint

ROOT = Path(__file__).parents[2]
SHOWN_ADDRESS = "127.0.0.1:7447"
RUN_S, TRIALS = 2.0, 2
"""No run takes longer and no campaign has more trials here, whatever the document shows."""
PRINTED = "printed.txt"
"""File beside the folder of a run that several documents use: what the run printed."""
_PLAYED = re.compile(rf"rpod run ([a-z-]+) --speed max(?: --out (\S+))? --duration {RUN_S:g}")
"""A run of a shipped scenario that any document may show. It is played once for all of them."""
_TIMEOUT_S = 240.0  # kernels may have to be compiled first
_ENDED = (0, -signal.SIGTERM)


class Playground:
    """Runs blocks: files are written, commands and Python are run, outputs are compared."""

    def __init__(self, folder: Path, log_of: Callable[[str], Path]) -> None:
        self._folder, self._log_of = folder, log_of
        self._address = free_endpoint().removeprefix("tcp/")
        self._names: dict[str, Any] = {"__name__": "__main__"}
        self._printed = ""
        self._background = ExitStack()
        programs = Path(sys.executable).parent
        (folder / ".venv").symlink_to(
            programs.parent
        )  # documents name programs as they are in the repository
        self._environment = os.environ | {
            "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
            "COLUMNS": "120",
        }
        self._kinds: dict[str, Callable[[Block], None]] = {
            "": self._plain,
            "in full": self._in_full,
            "not run": self._leave_out,
            "in the background": self._start,
            "output": self._compare,
            "same as": self._same,
            "given": self._give,
            "end the background": lambda _: self.close(),
        }

    def close(self) -> None:
        """End the processes in the background, the last first."""
        self._background.close()

    def take(self, block: Block) -> None:
        """Run a block, or fail with its document and line."""
        self._kinds[block.kind](block)

    # --- kinds of blocks ---

    def _plain(self, block: Block) -> None:
        if block.title:
            (self._folder / block.title).write_text(self._here(block.text), "utf-8")
        elif block.language == "sh":
            self._printed = "".join(self._run(block, shortened(command)) for command in commands(block.text))
        elif block.language == "python":
            self._printed = self._python(block)
        else:
            shown = block.language in ("", "text")
            assert shown, (
                f"{block}: {block.language!r} is not run: give the block a title, or say why in a comment"
            )

    def _in_full(self, block: Block) -> None:
        self._printed = "".join(self._run(block, command) for command in commands(block.text))

    def _leave_out(self, block: Block) -> None:
        assert block.said, f"{block}: 'not run' needs a reason"

    def _start(self, block: Block) -> None:
        for command in commands(block.text):
            process = subprocess.Popen(
                ["bash", "-c", f"exec {self._here(command)}"],
                cwd=self._folder,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
            )
            assert process.stderr
            self._background.callback(_end, process, f"{block}: {command}")
            Lines(process.stderr).wait_for("ready: ")

    def _compare(self, block: Block) -> None:
        options = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
        same = doctest.OutputChecker().check_output(block.text, self._printed, options)
        assert same, f"{block}: shown\n{block.text}\nprinted\n{self._printed}"

    def _same(self, block: Block) -> None:
        file = block.document.parent / block.said
        assert block.text == file.read_text("utf-8"), f"{block} is not what is in {file}"
        (self._folder / file.name).write_text(self._here(block.text), "utf-8")

    def _give(self, block: Block) -> None:
        name, _, scenario = block.said.partition(" from ")
        if not scenario:
            shutil.copytree(ROOT / name, self._folder / name)
            return
        shutil.copyfile(self._log_of(scenario), self._folder / name)

    # --- commands and Python ---

    def _run(self, block: Block, command: str) -> str:
        if command.startswith("make "):
            return _make(block, command)
        if played := _PLAYED.fullmatch(command):
            return self._played(played[1], self._folder / (played[2] or "runs"))
        ended = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", self._here(command)],
            cwd=self._folder,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_S,
            check=False,
        )
        assert ended.returncode == 0, (
            f"{block}: {command}: exit {ended.returncode}\n{ended.stdout}{ended.stderr}"
        )
        return ended.stdout

    def _played(self, scenario: str, out: Path) -> str:
        """Copy a run that was played for all documents into a folder; return what it printed."""
        run = self._log_of(scenario).parent
        shutil.copytree(run, out / run.name)
        return (run.parent / PRINTED).read_text("utf-8")

    def _python(self, block: Block) -> str:
        tree = ast.parse(self._here(block.text), str(block.document))
        ast.increment_lineno(tree, block.line - 1)
        printed = io.StringIO()
        with contextlib.chdir(self._folder), contextlib.redirect_stdout(printed):
            exec(compile(tree, str(block.document), "exec"), self._names)  # noqa: S102 - the project's own text
        return printed.getvalue()

    def _here(self, text: str) -> str:
        """Return a text with a free endpoint in place of the usual one."""
        return text.replace(SHOWN_ADDRESS, self._address)


def commands(text: str) -> list[str]:
    """Return the commands of a shell block: a line each, but for lines that go on."""
    lines = text.replace("\\\n", " ").splitlines()
    bare = (re.sub(r"(^|\s)#.*$", "", line).strip() for line in lines)
    return [line for line in bare if line]


def shortened(command: str) -> str:
    """Return a command with short runs and few trials."""
    if re.match(r"(\S*/)?rpod run\b", command):
        asked = re.search(r"--duration (\S+)", command)
        shortest = min(float(asked[1]), RUN_S) if asked else RUN_S
        return re.sub(r" --duration \S+", "", command) + f" --duration {shortest:g}"
    if re.match(r"(\S*/)?rpod campaign\b", command):
        return re.sub(r"--trials \d+", f"--trials {TRIALS}", command)
    return command


def _make(block: Block, command: str) -> str:
    """Let make say what it would do: its targets are run by ``make check`` itself."""
    ended = subprocess.run(
        ["bash", "-c", f"{command} --dry-run"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=_TIMEOUT_S,
        check=False,
    )
    assert ended.returncode == 0, f"{block}: {command}\n{ended.stderr}"
    return ""


def _end(process: "subprocess.Popen[str]", what: str) -> None:
    process.terminate()
    code = process.wait(_TIMEOUT_S)
    assert code in _ENDED, f"{what}: exit {code}"
