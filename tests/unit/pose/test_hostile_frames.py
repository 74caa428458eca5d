"""No frame that the messages allow makes a method raise; ``make bounds`` also checks each index."""

import pytest
from tests import hostile_frames


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # NumPy tells of overflows, which are meant here
def test_no_frame_and_no_prediction_raises():
    assert not hostile_frames.failures(range(60))
