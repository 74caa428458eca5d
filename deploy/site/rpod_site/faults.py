"""Writes the reference of faults from the catalogue."""

from pathlib import Path

from rpod_schemas.faults import FAULTS

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
        f"| `{fault.name}` | {', '.join(fault.kinds)} | {fault.cause} | `{fault.line}` "
        f"| {_NEEDS[fault.needs]} | {fault.remedy} | {'yes' if fault.in_lockstep else ''} |"
        for fault in FAULTS
    ]
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(
        "# Faults\n\nThe catalogue that `rpod driver check`, scenarios (`faults:`) and the query "
        "`rpod/emulator/fault` share.\n\n"
        "| fault | kinds | cause | line of the check | seen with | remedy | can be injected in lockstep |\n"
        "|---|---|---|---|---|---|---|\n" + "\n".join(rows) + "\n",
        "utf-8",
    )
