"""The chaser's IMU as an input of the estimator, whose readings the model of motion uses."""

from rpod_estimator.inputs.stamped import StampedInput
from rpod_pose.navigation.dynamics.imu_track import ImuTrack
from rpod_runtime import Node, Received
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.config.estimator.dynamics import DynamicsConfig
from rpod_schemas.errors import MessageRejectedError, Reason
from rpod_schemas.messages import read_imu
from rpod_schemas.topics import IMU
from rpod_schemas.types import ImuReading


class ImuInput(StampedInput[ImuTrack]):
    """Receives ``chaser/imu``, and waits until a frame's stamp is covered.

    Args:
        node: the estimator's node.
        config: its configuration.
        track: where readings go; None if the IMU is not used.
    """

    name, lack = "imu", "behind"
    late_s = 0.05
    alarm = (
        "{topics} has no reading up to the frame's time: the chaser's rotation is unknown, and a track "
        "without measurements is lost sooner; check its publisher"
    )
    again = f"{IMU.name}: in order again"

    def __init__(self, node: Node, config: EstimatorConfig, track: ImuTrack | None) -> None:
        self._config = config.dynamics
        super().__init__(node, {} if track is None else {IMU: track}, in_lockstep=config.in_lockstep)

    def use(self, track: ImuTrack, received: Received) -> bool:
        """Add a reading of the IMU and return True; return False if it is not newer than all before."""
        return track.take(checked(read_imu(received.decode()), self._config))


def checked(reading: ImuReading, config: DynamicsConfig) -> ImuReading:
    """Return a reading unchanged if it has the data that the configuration needs.

    Raises:
        MessageRejectedError: a needed value is absent; the text names the field and the setting.
    """
    orbit = config.orbit
    if orbit is not None and orbit.R_orbit_chaser is None and reading.R_orbit_chaser is None:
        raise MessageRejectedError(
            Reason.MALFORMED,
            "orientation is absent, and dynamics.orbit needs the chaser's attitude in the orbital frame; set "
            "dynamics.orbit.R_orbit_chaser, or leave out dynamics.orbit",
        )
    used = config.imu is not None and config.imu.acceleration_bias_sigma_m_s2 is not None
    if used and reading.force_m_s2 is None:
        raise MessageRejectedError(
            Reason.MALFORMED,
            "linear acceleration is absent; leave out dynamics.imu.acceleration_bias_sigma_m_s2",
        )
    return reading
