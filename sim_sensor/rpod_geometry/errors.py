"""The errors of rays and lenses."""

from rpod_schemas.errors import RpodError


class GeometryError(RpodError):
    """Root of the errors that this package raises."""


class DistortionError(GeometryError):
    """The lens distortion maps two directions onto one pixel, or no direction onto a pixel."""

    def __init__(self, column: float, row: float) -> None:
        super().__init__(
            f"the lens distortion has no inverse at pixel ({column:.1f}, {row:.1f}); correct its coefficients"
        )
