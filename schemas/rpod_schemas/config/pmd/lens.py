"""The lens of a camera as a part of a configuration."""

from typing import Annotated, Any

from pydantic import BeforeValidator

from rpod_schemas.config.base import in_place, read_document
from rpod_schemas.types import Camera


def _read(value: Any) -> Any:
    return in_place(value, read_document)


Lens = Annotated[Camera, BeforeValidator(_read)]
"""A camera's size, fx, fy, cx, cy and distortion, written inline or as the path of a file."""
