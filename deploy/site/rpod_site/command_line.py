"""Writes the reference of the command line from the program itself."""

import re
import subprocess
import sys
from pathlib import Path


def write(file: Path) -> None:
    """Write what typer's own generator says of ``rpod``, under a title."""
    command = [sys.executable, "-m", "typer", "rpod.__main__", "utils", "docs", "--name", "rpod"]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    body = re.sub(r"^# `rpod`\n", "", told.lstrip(), count=1)
    # The list of verbs cuts each sentence at 45 letters; the sections below have them whole.
    body = re.sub(r"\*\*Commands\*\*:\n.*?(?=^## )", "", body, count=1, flags=re.DOTALL | re.MULTILINE)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f"# Command line\n\n{body}", "utf-8")
