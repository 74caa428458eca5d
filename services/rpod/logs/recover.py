"""``rpod recover`` from its arguments to its exit code."""

from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console
from rich.table import Table

from rpod.errors import failed
from rpod_analysis import AnalysisError
from rpod_analysis.recovery import recover
from rpod_runtime.process.lifecycle import EXIT_OK
from rpod_schemas.logs import Recovery


def recover_command(log: Path, *, out: Path | None, as_json: bool) -> int:
    """Recover a log and print what was lost; return the exit code."""
    try:
        recovery = recover(log, out)
    except AnalysisError as error:
        return failed("recover", error)
    if as_json:
        print(recovery.model_dump_json(indent=2))
    else:
        _print(recovery)
    return EXIT_OK


def _print(recovery: Recovery) -> None:
    console = Console(markup=False)
    table = Table(title=f"{recovery.messages} messages recovered", title_justify="left")
    table.add_column("topic", no_wrap=True)
    table.add_column("messages", justify="right")
    table.add_column("lost before the end, estimated", justify="right")
    table.add_column("last arrived, UTC", no_wrap=True)
    for name, topic in recovery.topics.items():
        table.add_row(name, str(topic.messages), str(topic.lost or "-"), _time(topic.last_ns))
    console.print(table)
    for line in _remarks(recovery):
        console.print(line, highlight=False)
    console.print(f"log   {recovery.out}", soft_wrap=True, highlight=False)


def _remarks(recovery: Recovery) -> list[str]:
    if recovery.whole:
        return ["Nothing was lost: the log was undamaged."]
    remarks = [
        f"{recovery.unreadable_bytes} of {recovery.size_bytes} bytes in {recovery.damaged_places} places "
        "could not be read."
    ]
    if recovery.chunks_over_limit:
        remarks.append(
            f"{recovery.chunks_over_limit} chunks announce too many bytes and were not read; if you trust "
            "the file, repeat with --no-limits."
        )
    if not recovery.closed:
        remarks.append("The end of the file is missing: it is not known how many messages followed.")
    if recovery.without_definition:
        remarks.append(f"{recovery.without_definition} messages are left out: their channel is not defined.")
    return remarks


def _time(stamp_ns: int | None) -> str:
    if stamp_ns is None:
        return "-"
    return f"{datetime.fromtimestamp(stamp_ns * 1e-9, UTC):%H:%M:%S.%f}"[:-3]
