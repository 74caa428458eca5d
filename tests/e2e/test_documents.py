"""Every command that the README shows is run, in its order, in an empty folder."""

import re
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from rpod_runtime.session import free_endpoint

ROOT = Path(__file__).parents[2]
SHOWN_ENDPOINT = "tcp/127.0.0.1:7447"
DAEMONS = ("router", "logger")
TIMEOUT_S = 120.0


def shown_commands():
    blocks = re.findall(r"```sh\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), re.S)
    lines = [line.split("#")[0].strip() for block in blocks for line in block.splitlines()]
    return [line for line in lines if line]


def test_every_make_target_shown_is_one():
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text("utf-8"), re.M)
    documents = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
    shown = {
        name for file in documents for name in re.findall(r"`?make ([a-z-]+)`?", file.read_text("utf-8"))
    }
    assert {"run", "test", "check", "bench"} <= shown
    assert shown <= set(targets)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("readme")


def as_run(command, endpoint):
    """Return the arguments of a shown command: this Python, a free port, three seconds a run."""
    verb, *arguments = command.removeprefix(".venv/bin/rpod ").split()
    if verb == "run" and "--duration" not in arguments:
        arguments += ["--duration", "3"]
    arguments = [argument.replace(SHOWN_ENDPOINT, endpoint) for argument in arguments]
    return [sys.executable, "-m", "rpod", verb, *arguments]


def test_the_verbs_shown_do_what_they_say(folder):
    shown = [command for command in shown_commands() if command.startswith(".venv/bin/rpod")]
    verbs = [command.split()[1] for command in shown]
    assert {"scenarios", "run", "report"} <= set(verbs)
    for command, verb in zip(shown, verbs, strict=True):
        if verb in DAEMONS:
            continue
        arguments = [
            str(match)
            for argument in as_run(command, "")
            for match in (sorted(folder.glob(argument)) if "*" in argument else [argument])
        ]
        ended = subprocess.run(
            arguments, cwd=folder, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
        )
        assert ended.returncode == 0, (command, ended.stderr)


def test_the_daemons_shown_get_ready(folder):
    endpoint = free_endpoint()
    shown = [command for command in shown_commands() if command.split()[1] in DAEMONS]
    assert [command.split()[1] for command in shown] == list(DAEMONS)
    with ExitStack() as stack:
        for command in shown:
            process = subprocess.Popen(
                as_run(command, endpoint), cwd=folder, stderr=subprocess.PIPE, text=True
            )
            stack.callback(process.wait, TIMEOUT_S)
            stack.callback(process.terminate)
            assert process.stderr is not None
            stack.callback(process.stderr.close)
            assert any("ready: " in line for line in iter(process.stderr.readline, ""))
