"""The camera's cases: frames of the mock-up, and what a peer that takes points sees of them."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from peers.benchmark import Case, Clouds, Criterion, disturbed
from rpod.scenarios import find
from rpod_campaign.engine.trial.streams import stream
from rpod_campaign.pmd.poses import SUCCESS_DEG, SUCCESS_M, drawn
from rpod_campaign.pmd.scene import Stage, still
from rpod_campaign.pmd.world import NOMINAL
from rpod_pose.pmd.depth_view import usable_image
from rpod_schemas.config.pmd.methods import DepthImageConfig
from rpod_schemas.types import Float32Array, PmdFrame
from rpod_target import Target

PMD = Clouds("pmd", Criterion(SUCCESS_DEG, SUCCESS_M))
STARTS = ((2.0, 0.03), (10.0, 0.2), (20.0, 0.5))
"""Errors of the poses that tracking starts from, deg and m."""
RANGE_M = (3.0, 6.0)
"""Ranges of the target's middle, uniform; its front is within 45 deg."""
_SCENARIO = "mockup-tumbling"
"""Its camera and its sun; nothing is calibrated."""
_MOST_POINTS = 20_000


@dataclass(frozen=True, eq=False)
class CameraScene:
    """What a peer may know before the first frame."""

    target: Target
    angle_deg: float
    """How far off tracking starts."""
    distance_m: float


@dataclass(frozen=True, eq=False)
class CameraView:
    """A frame, and the points of it."""

    frame: PmdFrame
    returns_m: Float32Array
    """Shape (N, 3): a point every four pixels, the median of it and its neighbours, without the ghosts that
    stray light makes of the background: what our own trackers take."""

    @classmethod
    def of(cls, frame: PmdFrame) -> "CameraView":
        """Return a frame with its points; none where it is no image of the target."""
        image = usable_image(frame, DepthImageConfig())
        points_m = np.zeros((0, 3)) if isinstance(image, str) else image.points(_MOST_POINTS)
        return cls(frame, points_m.astype(np.float32))


def camera_cases(scene: CameraScene, *, seed: int, trials: int) -> Iterator[Case[CameraView]]:
    """Yield trials: the mock-up's front in single frames."""
    stage = Stage(find(_SCENARIO), NOMINAL, seed=seed, trial=0)
    for trial in range(trials):
        truth = drawn(scene.target, "front", RANGE_M, stream(seed, trial))
        start = disturbed(
            truth, stream(seed, trial, 1), angle_deg=scene.angle_deg, distance_m=scene.distance_m
        )
        yield Case(CameraView.of(still(stage, truth, number=trial).frame), truth, start)
