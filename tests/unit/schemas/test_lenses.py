"""Lenses of CameraInfo that no camera has are refused by their field."""

import pytest

from rpod_schemas.errors import MessageRejectedError
from rpod_schemas.messages.lenses import coefficients


@pytest.mark.parametrize("value", [float("inf"), float("nan"), 1e300])
@pytest.mark.parametrize("model", ["plumb_bob", "equidistant", "rational_polynomial"])
def test_a_coefficient_that_no_lens_has_is_refused(model: str, value: float) -> None:
    with pytest.raises(MessageRejectedError, match="distortion"):
        coefficients(model, (0.1, value, 0.0, 0.0), 0.5)
