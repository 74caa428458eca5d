"""Table of the rows."""

import json
from collections import defaultdict
from pathlib import Path
from typing import Any

from rich.console import Console


def show(path: Path) -> None:
    """Print which faults were named, within how long, and what else was named."""
    rows: dict[tuple[str, str], list[dict[str, Any]]] = defaultdict(list)
    for text in path.read_text("utf-8").splitlines():
        each = json.loads(text)
        rows[each["kind"], each["fault"]].append(each)
    console = Console(width=200, highlight=False, markup=False)
    for (kind, fault), several in rows.items():
        found = [each["steady_s"][fault] for each in several if fault in each["steady_s"]]
        others = sorted({name for each in several for name in each["first_s"] if name != fault})
        within = f"{min(found)} to {max(found)} s" if found else "-"
        console.print(f"{kind:6} {fault or 'good':18} {len(found)} of {len(several)}  {within:12} {others}")
