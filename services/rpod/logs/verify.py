"""``rpod verify-log`` from its arguments to its exit code."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

from rpod_runtime.process.lifecycle import EXIT_FAILURE, EXIT_OK
from rpod_security.errors import ChainError
from rpod_security.log_verification import Verdict, verify


def verify_log_command(logs: Sequence[Path], *, authority: Path | None, as_json: bool) -> int:
    """Compare logs with their chains; return the exit code."""
    try:
        verdicts = [verify(log, authority=authority) for log in logs]
    except (ChainError, OSError) as error:
        print(f"rpod verify-log: {error}", file=sys.stderr)
        return EXIT_FAILURE
    if as_json:
        print(json.dumps({str(each.log): _document(each) for each in verdicts}, indent=2))
    else:
        for each in verdicts:
            _print(each)
    return EXIT_OK if all(each.intact for each in verdicts) else EXIT_FAILURE


def _document(verdict: Verdict) -> dict[str, object]:
    return {
        "intact": verdict.intact,
        "closed": verdict.closed,
        "signed_by": verdict.signed_by or None,
        "verified_bytes": verdict.verified_bytes,
        "problems": verdict.problems,
        "notes": verdict.notes,
    }


def _print(verdict: Verdict) -> None:
    state = "as it was written" if verdict.intact else "NOT as it was written"
    signed = f", signed by {verdict.signed_by}" if verdict.signed_by else ""
    print(f"{verdict.log}: {state}, {verdict.verified_bytes} bytes verified{signed}")
    for text in verdict.problems:
        print(f"  problem: {text}")
    for text in verdict.notes:
        print(f"  note: {text}")
