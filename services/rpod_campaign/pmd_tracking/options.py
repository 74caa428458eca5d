"""Options of ``pmd-tracking``."""

from typing import ClassVar, Literal

from rpod_campaign.engine.options import Model, Names, Trials
from rpod_campaign.pmd.options import Approach, Frames, Methods, PmdOptions, Radii, Through


class Options(PmdOptions):
    """Tracking in the images of a PMD camera."""

    title: ClassVar[str] = "Tracking in the images of a PMD camera"

    trials: Trials = 1
    model: Model = None
    scenario: Names = ("oblique", "tumbling", "approach")
    """Scenarios with the camera, by name; 'mockup-' may be left out."""
    ranges: Approach = None
    method: Methods = (
        "icp-reverse-calibration",
        "icp-reverse-calibration-plane",
        "epnp",
        "hybrid",
        "signed-distance",
        "joint",
    )
    radius: Radii = None
    frames: Frames = "keyframes"
    through: Through | None = None
    """First guess of an image: the last estimate, the last true pose, or the navigator's prediction; both
    selects tracker and navigator. By default tracker, and for the 2018 paper's Table 2 truth as well."""
    depth: Literal["raw", "calibrated", "both"] = "raw"
    """Depth with all of the camera's wiggling error, or with the error that remains after a calibration."""
