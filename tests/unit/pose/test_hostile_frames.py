"""No frame that the messages allow makes a method raise; ``make bounds`` also checks each index."""

import pytest
from tests import hostile_frames


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # NumPy tells of overflows, which are meant here
@pytest.mark.parametrize("kind", hostile_frames.KINDS_OF_SENSOR)
def test_no_frame_and_no_prediction_raises(kind):
    assert not hostile_frames.failures(range(60), kind)
