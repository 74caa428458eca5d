"""Parameters of the search for the target in one PMD frame."""

from typing import Annotated

from pydantic import Field

from rpod_schemas.config.base import NonNegative, Positive, Share
from rpod_schemas.config.pmd_methods import DepthErrorConfig
from rpod_schemas.config.sensor import MethodConfig
from rpod_schemas.config.tuning import BUDGET, BY_HAND, Provenance, Tuning

Count = Annotated[int, Field(gt=0)]


class PmdSceneConfig(Tuning):
    """What of a frame the search looks at."""

    ghost_share: Annotated[Share, BY_HAND] = 0.08
    """Depth is dropped where the amplitude is below this share of the image's mean: stray light."""
    lit_share: Annotated[Share, BY_HAND] = 0.25
    """A pixel without depth shows the target where its amplitude exceeds the sky's by far, or this share of
    what the darkest pixels with depth have."""
    pixels: Annotated[Count, BUDGET] = 1600
    """About how many pixels of the target are looked at: the stride follows from it."""
    most_stride_px: Annotated[Count, BUDGET] = 5
    """Largest stride across and down."""
    min_points: Annotated[int, Field(ge=20), BY_HAND] = 40
    """Fewer of those pixels with depth are no image of the target."""
    most_off_centre: Annotated[Share, BY_HAND] = 0.1
    """Share of the image's size by which the principal point may lie off its middle."""
    most_oblong: Annotated[float, Field(ge=1), BY_HAND] = 1.1
    """Most ratio of the focal lengths."""


class PmdModelConfig(Tuning):
    """What is expected of the pixels of a frame under the right pose; it need not be exact."""

    sigma_m: Annotated[
        Positive, Provenance("hand, mock-up", "uncalibrated wiggling, as JointDepthConfig.raw")
    ] = 0.04
    """Standard deviation of a depth but for its noise: uncalibrated wiggling, as ``JointDepthConfig.raw``."""
    most_noise_m: Annotated[Positive, BY_HAND] = 0.1
    """Noise, as neighbouring pixels tell it, is never taken for more."""
    slack_m: Annotated[Positive, BY_HAND] = 0.015
    """The same of the surface across its normal: on a steep face it counts for more along the ray."""
    outlier_loss: Annotated[Positive, BY_HAND] = 3.5
    """Most loss of a depth: mixed pixels and multiple reflections are wrong altogether."""
    strange_log_amplitude: Annotated[
        Positive,
        Provenance(
            "hand, mock-up", "a factor of ten from the darkest paint to the brightest; the value is chosen"
        ),
    ] = 1.0
    """Least standard deviation of the amplitude's logarithm where the materials may be others than the
    file's: any paint may be any other, a factor of ten from the darkest to the brightest."""
    amplitude_outlier_loss: Annotated[Positive, BY_HAND] = 2.3
    """Most loss of an amplitude: of glints no class of brightness knows anything."""
    lost_loss: Annotated[NonNegative, BY_HAND] = 0.3
    """Loss of a lit pixel without depth where the pose predicts surface: glints and dark parts lose depth."""
    dark_loss: Annotated[NonNegative, BY_HAND] = 3.0
    """Loss of a dark pixel where the pose predicts surface."""
    beyond_loss: Annotated[NonNegative, BY_HAND] = 4.0
    """Loss of a pixel with depth, or lit, where the pose predicts none."""


class PmdLimitsConfig(Tuning):
    """What a pose that explains a frame is granted."""

    max_loss: Positive
    """Most mean loss a pixel."""
    min_explained_share: Share
    """Least share of pixels on which pose and frame agree."""
    max_patch_loss: Positive
    """Most mean loss a pixel of the worst patch: a detail that is missing or out of place is small."""
    max_face_loss: Positive
    """Most mean loss a pixel of the worst face-wide patch: another surface is a little wrong all over."""
    facts: Positive
    """How many independent errors a frame has: neighbours share those of camera and model. The fewer, the
    more a rival has to be worse."""


class PmdVerdictConfig(Tuning):
    """When a pose explains a frame."""

    patch_px: Annotated[Count, BY_HAND] = 5
    """Side of a square patch of the pixels that are looked at, about a tenth of a metre wide."""
    face_px: Annotated[Count, BY_HAND] = 13
    """Side of a larger patch, about as wide as a face: of one material."""
    as_filed: Annotated[PmdLimitsConfig, BY_HAND] = PmdLimitsConfig(
        max_loss=0.6, min_explained_share=0.87, max_patch_loss=2.0, max_face_loss=1.0, facts=100.0
    )
    """Of depth, outline and amplitude, where the materials are those of the target's file."""
    shape: Annotated[PmdLimitsConfig, BY_HAND] = PmdLimitsConfig(
        max_loss=0.45, min_explained_share=0.96, max_patch_loss=1.4, max_face_loss=0.65, facts=45.0
    )
    """Of depth and outline, which are asked whatever the materials are, and alone where these are others."""
    ambiguous_weight: Annotated[float, Field(gt=0.5, lt=1), BY_HAND] = 0.95
    """Below this weight of the best hypothesis the result is ambiguous."""


class PmdAcquisitionTuning(Tuning):
    """Numbers of candidates and limits of the search."""

    compared: Annotated[Count, BY_HAND] = 300
    """Of them, the best ones that are compared with more of it."""
    refined: Annotated[Count, BY_HAND] = 24
    """Of those, the best ones that are drawn onto the frame and rendered."""
    model_points: Annotated[Count, BUDGET] = 240
    """Surface points that stand for the target while attitudes are compared."""
    truncation_m: Annotated[Positive, BY_HAND] = 0.5
    """Distances beyond this cost no more."""
    coarse_points: Annotated[Count, BUDGET] = 128
    """Measured points that candidates are drawn in on."""
    fine_points: Annotated[Count, BUDGET] = 500
    """Measured points that the best are finished on."""
    turned: Annotated[Count, BY_HAND] = 3
    """Most poses whose turns by near-symmetries and about the axes are tried."""
    turns: Annotated[Count, BY_HAND] = 8
    """Best turns of each that are drawn onto the frame."""
    finished: Annotated[Count, BY_HAND] = 4
    """Best distinct poses that are finished."""
    rival_loss: Annotated[Positive, BY_HAND] = 200.0
    """Of them, those that are behind the best by no more are sharpened on the outline too."""
    distinct_deg: Annotated[NonNegative, BY_HAND] = 8.0
    """Poses whose attitudes differ by less are one."""
    near_attitudes: Annotated[Count, BY_HAND] = 12000
    """Spread over all of SO(3), of which those near a roughly known pose are compared."""
    near_refined: Annotated[Count, BY_HAND] = 12
    """Of those near, the best ones that are drawn onto the frame and rendered."""
    near_deg: Annotated[Positive, BY_HAND] = 45.0
    """How far attitudes may be from a pose that is known roughly, where only that is searched."""
    scene: PmdSceneConfig = PmdSceneConfig()
    """What of a frame is looked at."""
    model: PmdModelConfig = PmdModelConfig()
    """What is expected of it."""
    verdict: PmdVerdictConfig = PmdVerdictConfig()
    """When a pose explains it."""
    scale_m: Annotated[Positive, BY_HAND] = 0.1
    """Distance from the surface within which a measured point counts for the covariance."""
    errors: Annotated[DepthErrorConfig, BY_HAND] = DepthErrorConfig()
    """What the covariance assumes."""


class PmdAcquisitionConfig(MethodConfig):
    """Search over all attitudes for the target in one frame of a PMD camera."""

    kind: str = "view_search"
    """Selects this method."""
    attitudes: Count = 3000
    """Attitudes over all of SO(3) that are compared with the frame. Raise it where the search misses a target
    with many alike views; the time of a search grows with it."""
    tuning: PmdAcquisitionTuning = PmdAcquisitionTuning()
    """Limits and numbers that are no part of the promise; change them only to study the method."""
