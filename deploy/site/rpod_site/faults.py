"""Writes the reference of faults from the catalogue."""

from pathlib import Path

from rpod_schemas.faults import ALL_FAULTS

_NEEDS = {
    None: "",
    "rate": "the nominal rate (`--rate`)",
    "truth": "truth and `--target`; of a LIDAR its info",
    "plane": "a plane in view",
    "info": "the sensor's info",
}


def write(file: Path) -> None:
    """Write a table of all faults."""
    rows = [
        f"| `{fault.name}` | {fault.subject} | {', '.join(fault.kinds)} | {fault.size or ''} | {fault.cause} "
        f"| {f'`{fault.line}`' if fault.line else ''} "
        f"| {_NEEDS[fault.needs]} | {fault.remedy} | {'yes' if fault.in_lockstep else ''} |"
        for fault in ALL_FAULTS
    ]
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(
        "# Faults\n\nThe catalogue that `rpod driver check`, scenarios (`faults:`) and queries share. "
        "The query `fault` goes to the service that has the fault: the emulator (messages and scene), "
        "the proxy (links), "
        "the supervisor (processes), the logger (its disk).\n\n"
        "| fault | of | kinds | sizes | cause | line of the check | seen with | remedy "
        "| can be injected in lockstep |\n"
        "|---|---|---|---|---|---|---|---|---|\n" + "\n".join(rows) + "\n",
        "utf-8",
    )
