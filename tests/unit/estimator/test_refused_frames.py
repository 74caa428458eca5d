"""What becomes of a track while its sensor's frames hold no measurement."""

import pytest
from navigator_rig import SECOND_NS, START_S, tracking

from rpod_estimator.estimator import Estimator
from rpod_estimator.frame_reader import Arrived
from rpod_schemas.config.estimator import EstimatorConfig, PmdInput
from rpod_schemas.errors import Reason
from rpod_schemas.types import Mode
from rpod_target import load_target


def modes_while(refused: Reason) -> list[Mode]:
    """Return the modes of an estimator that tracks, while each frame is refused for a reason."""
    config = EstimatorConfig(target="mockup", sensors=(PmdInput(),))
    estimator, made = Estimator(config, load_target("mockup")), tracking()
    estimator._navigator, estimator._state = made.navigator, made.state
    modes = []
    for number in range(1, 40):
        stamp_ns = round((START_S + 1.0 + number / 10.0) * SECOND_NS)
        arrived = Arrived("pmd", stamp_ns, 0.0, None, f"{refused}: no finite pixel", refused)
        modes.append(estimator.process(arrived).status.mode)
    return modes


@pytest.mark.parametrize("refused", [Reason.NOT_FINITE, Reason.EMPTY, Reason.FROZEN])
def test_a_track_coasts_and_is_lost_while_no_frame_holds_a_measurement(refused):
    modes = modes_while(refused)
    assert Mode.TRACKING not in modes[3:]
    assert Mode.COASTING in modes
    assert modes[-1] == Mode.LOST


@pytest.mark.parametrize("refused", [Reason.LATE, Reason.FUTURE])
def test_a_frame_with_a_wrong_stamp_tells_no_time(refused):
    assert set(modes_while(refused)) == {Mode.TRACKING}
