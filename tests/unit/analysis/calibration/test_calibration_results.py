"""What the verbs of calibration say about their results."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rpod.calibrate.background import background_command
from rpod_analysis.calibration import background
from rpod_analysis.calibration.background import learned_backgrounds
from rpod_analysis.calibration.hand_eye.results import mount_findings, mount_of
from rpod_analysis.errors import CalibrationError
from rpod_schemas.config.source import FORWARD_BORESIGHT, SourceConfig


@pytest.mark.parametrize("axes", ["boresight", "forward"])
def test_the_printed_mount_is_that_of_the_file(axes):
    turn = Rotation.from_euler("ZYX", [30.0, -20.0, 10.0], degrees=True)
    boresight = turn * (FORWARD_BORESIGHT.rotation if axes == "forward" else Rotation.identity())
    state = SimpleNamespace(R_X=boresight.as_matrix(), t_X=np.array([0.1, 0.2, 0.3]))
    found = SimpleNamespace(state=state, covariance=np.eye(15) * 1e-6, sigma=lambda _: 0.0)
    sensor = SimpleNamespace(name="top", T_chaser_sensor=None)
    poses = SimpleNamespace(source=SourceConfig(axes=axes), sensor=sensor)
    line = next(mount_findings(found, poses))
    assert [float(each) for each in re.findall(r"-?\d+\.\d+", line)] == [100, 200, 300, 30, -20, 10]
    in_file = mount_of(found, poses)
    assert np.allclose(in_file.rotation.as_matrix(), turn.as_matrix())
    assert np.allclose(in_file.translation, [0.1, 0.2, 0.3])


@pytest.fixture
def frames(monkeypatch):
    """Return the range images of each sensor of a log, to be filled by the test."""
    images: dict[str, list] = {}
    sensors = lambda _log: {name: SimpleNamespace(kind="pmd") for name in images}  # noqa: E731
    monkeypatch.setattr(background, "find_sensors", sensors)
    monkeypatch.setattr(
        background,
        "sensor_frames",
        lambda _log, name, _kind: iter([SimpleNamespace(range_image_m=each) for each in images[name]]),
    )
    return images


LOG = SimpleNamespace(paths=[SimpleNamespace(name="empty.mcap")])
IMAGE = np.full((3, 4), 2.0, np.float32)


def test_a_sensor_without_a_background_is_named_with_the_reason(frames):
    frames |= {"front": [IMAGE] * 12, "top": [None] * 12, "side": []}
    learned = learned_backgrounds(LOG)
    assert list(learned.backgrounds) == ["front"]
    assert "publish rows and columns" in learned.left_out["top"]
    assert "no complete frame" in learned.left_out["side"]
    del frames["front"]
    with pytest.raises(CalibrationError, match=r"no sensor shows a background\. 'side': no complete frame"):
        learned_backgrounds(LOG)


def test_the_command_names_what_it_leaves_out(frames, tmp_path, monkeypatch, capsys):
    class Opened(SimpleNamespace):
        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

    frames |= {"front": [IMAGE] * 12, "top": [None] * 12}
    log = Opened(paths=LOG.paths, odometry=lambda _topic: iter(()), unreadable=())
    monkeypatch.setattr("rpod.calibrate.background.open_log", lambda _path: log)
    monkeypatch.setattr("rpod.calibrate.background.print_unreadable", lambda *_: None)
    assert background_command(tmp_path / "empty.mcap", out=tmp_path / "known.yaml", as_json=True) == 0
    told = capsys.readouterr()
    assert "rpod calibrate background: 'top' has no background: its frames are no image" in told.err
    assert list(json.loads(told.out)["left_out"]) == ["top"]
