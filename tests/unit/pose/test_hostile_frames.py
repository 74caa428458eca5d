"""No frame that the messages allow makes a method raise.

``make bounds`` tries 60 frames of each kind, and checks each index. These are 24, after which shapes and
types come again.
"""

import shutil

import pytest
from tests import hostile_frames


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # NumPy tells of overflows, which are meant here
@pytest.mark.parametrize("kind", hostile_frames.KINDS_OF_SENSOR)
def test_no_frame_and_no_prediction_raises(kind):
    assert not hostile_frames.failures(range(24), kind)


def test_any_change_of_the_code_or_of_a_package_is_seen(tmp_path):
    for room in hostile_frames.ROOMS:
        shutil.copytree(
            hostile_frames.ROOT / room, tmp_path / room, ignore=shutil.ignore_patterns("__pycache__")
        )
    changed = (
        "services/rpod_pose/registration/lie_group.py",
        "sim_sensor/rpod_target/targets/mockup.yaml",
        "tests/hostile_frames.py",
        "deploy/supply/requirements.lock",
    )
    for name in changed[2:]:
        (tmp_path / name).parent.mkdir(parents=True)
        shutil.copy(hostile_frames.ROOT / name, tmp_path / name)
    known = {hostile_frames.digest_of_code()}
    assert hostile_frames.digest_of_code(tmp_path) in known
    for name in changed:
        assert (tmp_path / name).is_file()
        with (tmp_path / name).open("a") as file:
            file.write("\n")
        known.add(hostile_frames.digest_of_code(tmp_path))
    assert len(known) == 1 + len(changed)
