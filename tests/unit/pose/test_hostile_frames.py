"""No frame that the messages allow makes a method raise.

``make bounds`` tries 60 frames of each kind, and checks each index. These are twelve, after which shapes and
types come again.
"""

import pytest
from tests import hostile_frames


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # NumPy tells of overflows, which are meant here
@pytest.mark.parametrize("kind", hostile_frames.KINDS_OF_SENSOR)
def test_no_frame_and_no_prediction_raises(kind):
    assert not hostile_frames.failures(range(12), kind)
