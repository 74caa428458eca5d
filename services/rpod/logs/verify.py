"""``rpod verify-log`` from its arguments to its exit code."""

import json
from collections.abc import Sequence
from pathlib import Path

from rpod.errors import failed
from rpod_runtime.process.lifecycle import EXIT_FAILURE, EXIT_OK
from rpod_security.errors import ChainError
from rpod_security.log_verification import Verification, verify


def verify_log_command(logs: Sequence[Path], *, authority: Path | None, as_json: bool) -> int:
    """Compare logs with their chains; return the exit code."""
    try:
        results = [verify(log, authority=authority) for log in logs]
    except (ChainError, OSError) as error:
        return failed("verify-log", error)
    if as_json:
        print(json.dumps({str(each.log): _document(each) for each in results}, indent=2))
    else:
        for each in results:
            _print(each)
    return EXIT_OK if all(each.intact for each in results) else EXIT_FAILURE


def _document(result: Verification) -> dict[str, object]:
    return {
        "intact": result.intact,
        "closed": result.closed,
        "signed_by": result.signed_by or None,
        "verified_bytes": result.verified_bytes,
        "problems": result.problems,
        "notes": result.notes,
    }


def _print(result: Verification) -> None:
    state = "as it was written" if result.intact else "NOT as it was written"
    signed = f", signed by {result.signed_by}" if result.signed_by else ""
    print(f"{result.log}: {state}, {result.verified_bytes} bytes verified{signed}")
    for text in result.problems:
        print(f"  problem: {text}")
    for text in result.notes:
        print(f"  note: {text}")
