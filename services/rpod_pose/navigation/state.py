"""What the navigator remembers between two steps, and what it has to say after one."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from scipy.spatial.transform import RigidTransform

from rpod_pose.belief import Record
from rpod_pose.navigation.history import History
from rpod_schemas.arrays import FloatArray
from rpod_schemas.types import EstimatorStatus, Mode, Odometry


@dataclass(frozen=True, eq=False)
class GivenPose:
    """A pose from outside to start from, taken as of the first frame where it has no stamp."""

    T_chaser_target: RigidTransform
    covariance: FloatArray
    stamp_ns: int | None = None


@dataclass(frozen=True, eq=False)
class NavigatorState:
    """All that the navigator remembers between two steps."""

    mode: Mode = Mode.ACQUIRING
    history: History | None = None
    """The filter's state and its recent past."""
    given: GivenPose | None = None
    heard_ns: int = 0
    """Newest stamp of a measurement, accepted or not."""
    accepted_ns: int = 0
    """Newest stamp of an accepted measurement."""
    lost_ns: int = 0
    """When the target was lost."""
    shown_ns: int = 0
    """Newest stamp of an odometry: the stamps of the output never go back."""
    rejections: int = 0
    """In a row."""
    confirmations: int = 0
    """Frames that agreed since the acquisition."""
    records: Mapping[str, Record] = field(default_factory=dict)
    """How often frames did not support what was tracked, by the sensor's name; outlasts the track."""


@dataclass(frozen=True, eq=False)
class Output:
    """What a step has to say."""

    status: EstimatorStatus
    odometry: Odometry | None
