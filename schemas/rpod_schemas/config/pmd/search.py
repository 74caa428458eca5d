"""Parameters of the search for the target in one PMD frame."""

from typing import Annotated

from pydantic import Field

from rpod_schemas.config.base import Count, NonNegative, Positive, Share
from rpod_schemas.config.sensor import MethodConfig
from rpod_schemas.config.tuning import (
    BUDGET,
    BY_HAND,
    GRID,
    OF_CAMERA,
    ONE_IN_TWENTY,
    THREE_SIGMA,
    Provenance,
    Tuning,
)


class PmdSceneConfig(Tuning):
    """Pixels of a frame that the search uses."""

    ghost_share: Annotated[Share, BY_HAND] = 0.08
    """Share of the brightness around a pixel below which its depth is dropped, as stray light."""
    lit_share: Annotated[Share, BY_HAND] = 0.25
    """Share of the amplitude of the darkest pixels with depth above which a pixel without depth shows the
    target; so does one whose amplitude exceeds the sky's by far."""
    pixels: Annotated[Count, BUDGET] = 1600
    """Approximate number of pixels of the target that are used; the stride follows from it."""
    most_stride_px: Annotated[Count, BUDGET] = 5
    """Largest stride across and down, px."""
    min_points: Annotated[int, Field(ge=20), BY_HAND] = 40
    """Least number of used pixels with depth in an image of the target."""
    most_off_centre: Annotated[Share, BY_HAND] = 0.1
    """Largest distance of the principal point from the image's middle, as a share of the image's size."""
    most_oblong: Annotated[float, Field(ge=1), BY_HAND] = 1.1
    """Largest ratio of the focal lengths."""


class PmdModelConfig(Tuning):
    """Expected statistics of a frame's pixels at the right pose; they need not be exact."""

    sigma_m: Annotated[Positive, OF_CAMERA] = 0.04
    """Standard deviation of a depth without its noise, m: uncalibrated wiggling, as
    ``JointDepthConfig.raw``."""
    most_noise_m: Annotated[Positive, OF_CAMERA] = 0.1
    """Largest assumed noise of a depth, which is estimated from the neighbouring pixels, m."""
    slack_share: Annotated[Positive, BY_HAND] = 0.016
    """Standard deviation of the surface along its normal, as a share of the target's radius; on a steep face
    it is larger along the ray."""
    outlier_loss: Annotated[Positive, BY_HAND] = 3.5
    """Largest loss of a depth: mixed pixels and multiple reflections are entirely wrong."""
    strange_log_amplitude: Annotated[
        Positive,
        Provenance(
            "hand, mock-up", "a factor of ten from the darkest paint to the brightest; the value is chosen"
        ),
    ] = 1.0
    """Least standard deviation of the amplitude's logarithm if the materials may differ from the file's: any
    paint may be any other, a factor of ten from the darkest to the brightest."""
    amplitude_outlier_loss: Annotated[Positive, BY_HAND] = 2.3
    """Largest loss of an amplitude: no class of brightness predicts glints."""
    lost_loss: Annotated[NonNegative, BY_HAND] = 0.3
    """Loss of a lit pixel without depth at a predicted surface: glints and dark parts lose depth."""
    dark_loss: Annotated[NonNegative, BY_HAND] = 3.0
    """Loss of a dark pixel at a predicted surface."""
    beyond_loss: Annotated[NonNegative, BY_HAND] = 4.0
    """Loss of a pixel with depth, or of a lit one, at which the pose predicts no surface."""


class PmdAcquisitionTuning(Tuning):
    """Numbers of candidates and limits of the search."""

    attitudes: Annotated[Count, BUDGET] = 3000
    """Number of attitudes, evenly spread over SO(3), that are compared with the frame. The larger it is, the
    likelier is the right one among them where a target has many similar views."""
    compared: Annotated[Count, BUDGET] = 300
    """Number of the best attitudes that are compared with more of the frame."""
    refined: Annotated[Count, BUDGET] = 36
    """Number of the best of these that are aligned with the frame and rendered."""
    model_points: Annotated[Count, BUDGET] = 240
    """Number of surface points that represent the target while attitudes are compared."""
    truncation: Annotated[Positive, BY_HAND] = 0.53
    """Distance above which the cost is constant, over the target's radius."""
    scale_sigmas: Annotated[Positive, THREE_SIGMA] = 3.0
    """Least Geman-McClure scale of an alignment, in standard deviations of a range by the frame's noise."""
    outline_sigma: Annotated[
        Positive, Provenance("numerics", "the samples follow the best ones, so that the start hardly counts")
    ] = 0.05
    """Standard deviation of the first samples in the refinement on the outline: of the angles in rad, and of
    the place over the target's radius."""
    coarse_points: Annotated[Count, BUDGET] = 128
    """Number of measured points with which candidates are coarsely aligned."""
    fine_points: Annotated[Count, BUDGET] = 500
    """Number of measured points with which the best poses are refined."""
    turned: Annotated[Count, BUDGET] = 3
    """Largest number of poses whose turns are tried, near-symmetries and turns about the axes."""
    turns: Annotated[Count, BUDGET] = 8
    """Number of best turns of each pose that are aligned with the frame."""
    finished: Annotated[Count, BUDGET] = 6
    """Number of best distinct poses that are refined to the end."""
    rival_loss: Annotated[Positive, BY_HAND] = 200.0
    """Largest difference from the best pose's loss up to which such a pose is refined on the outline too."""
    rival_losses: Annotated[
        Positive,
        Provenance(
            "campaign",
            "population derive, seed 71, 14 bodies of 6 frames: rivals whose loss was within 19 to 1 of the "
            "best after the alignment had at most 1.5 times its loss before",
        ),
    ] = 2.0
    """Largest ratio of a pose's loss to that of the best one up to which the tracker aligns it as well, so
    that both are compared again."""
    settling: Annotated[int, Field(ge=0), BUDGET] = 6
    """Largest number of further alignments of a first pose, each from the last one's result, as long as the
    frame is likelier there and the pose has not settled."""
    settled_px: Annotated[
        Positive, Provenance("numerics", "a third of the least standard deviation of an edge's position")
    ] = 0.1
    """Motion of the target in the image by an alignment, px, below which a first pose has settled."""
    distinct_deg: Annotated[NonNegative, GRID] = 8.0
    """Angle between two attitudes, deg, below which their poses are the same."""
    near_attitudes: Annotated[Count, BUDGET] = 12000
    """Number of attitudes, evenly spread over SO(3), of which those near a roughly known pose are
    compared."""
    near_refined: Annotated[Count, BUDGET] = 12
    """Number of the best of these that are aligned with the frame and rendered."""
    near_deg: Annotated[Positive, BY_HAND] = 45.0
    """Largest angle of an attitude from a roughly known pose, deg, in a search near that pose."""
    scene: PmdSceneConfig = PmdSceneConfig()
    """Pixels of a frame that are used."""
    model: PmdModelConfig = PmdModelConfig()
    """Expected statistics of these pixels."""
    independent_pixels: Annotated[Positive, BY_HAND] = 100.0
    """Number of independent errors in a frame; neighbours share those of camera and model. The lower it is,
    the worse a pose must be not to be a rival."""
    independent_pixels_of_shape: Annotated[Positive, BY_HAND] = 45.0
    """The same for depth and outline alone, where the materials may not be those of the file."""
    ambiguous_weight: Annotated[float, Field(gt=0.5, lt=1), ONE_IN_TWENTY] = 0.95
    """Weight of the best hypothesis below which the result is ambiguous."""


class PmdAcquisitionConfig(MethodConfig):
    """Search over all attitudes for the target in one frame of a PMD camera."""

    kind: str = "view_search"
    """Selects this method."""
    tuning: PmdAcquisitionTuning = PmdAcquisitionTuning()
    """Limits and numbers of the method that are outside the public interface; change them only to study
    it."""
