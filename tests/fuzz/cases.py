"""Inputs that once failed: each is a file that a test reads from then on."""

import base64
import hashlib
import json
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Self

CASES = Path(__file__).parent / "found"


@dataclass(frozen=True)
class Case:
    """An input, and the subject that failed to read it."""

    subject: str
    data: bytes

    def write(self) -> Path:
        """Write the case under a name that follows from its content."""
        CASES.mkdir(exist_ok=True)
        name = self.subject.replace(" ", "-").replace("/", "_")
        path = CASES / f"{name}-{hashlib.sha256(self.data).hexdigest()[:8]}.json"
        packed = base64.b64encode(zlib.compress(self.data, 9)).decode()
        path.write_text(json.dumps({"subject": self.subject, "zlib_base64": packed}) + "\n", "utf-8")
        return path

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a case."""
        document = json.loads(path.read_text("utf-8"))
        return cls(document["subject"], zlib.decompress(base64.b64decode(document["zlib_base64"])))
