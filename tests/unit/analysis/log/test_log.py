import numpy as np
import pytest
from synthetic_log import EPOCH_NS, T_CHASER_SENSOR, Frame, SyntheticRun

from rpod_analysis import AnalysisError, find_sensors, lidar_scans, open_log, pmd_frames, read_run
from rpod_schemas.topics import DEPTH, TRUTH
from rpod_schemas.types import Mode

SECOND = 1_000_000_000


@pytest.fixture(scope="module")
def log_path(tmp_path_factory):
    return SyntheticRun().write(tmp_path_factory.mktemp("log") / "run.mcap")


def test_topics_are_told_with_types_and_counts(log_path):
    with open_log(log_path) as log:
        assert log.topics["truth/odometry"].type == "nav_msgs/msg/Odometry"
        assert log.topics["pmd/depth/image_raw"].count == 21
        assert log.topics["estimate/status"].type == "rpod_msgs/msg/EstimatorStatus"


def test_messages_come_in_the_order_of_arrival_and_decode(log_path):
    with open_log(log_path) as log:
        messages = list(log.messages(TRUTH, DEPTH.of("pmd")))
        arrivals = [message.log_ns for message in messages]
        assert arrivals == sorted(arrivals)
        assert {message.topic for message in messages} == {"truth/odometry", "pmd/depth/image_raw"}
        assert messages[0].decode().child_frame_id == "target"
        assert [m.sequence for m in messages if m.topic == "truth/odometry"][:3] == [1, 2, 3]


def test_a_slice_of_time_reads_only_the_chunks_that_it_touches(log_path):
    class CountingReads:
        def __init__(self, stream):
            self.stream, self.bytes = stream, 0

        def read(self, size=-1):
            data = self.stream.read(size)
            self.bytes += len(data)
            return data

        def __getattr__(self, name):
            return getattr(self.stream, name)

    with open_log(log_path) as log:
        checked = log._parts[0].reader._stream
        stream = checked._stream = CountingReads(checked._stream)
        start_ns = EPOCH_NS + SECOND
        stamps = [o.stamp_ns for o in log.odometry(TRUTH, start_ns=start_ns, end_ns=start_ns + SECOND // 10)]
        assert len(stamps) == 25
        assert all(abs(stamp - start_ns) < 0.11 * SECOND for stamp in stamps)
        assert 0 < stream.bytes < log_path.stat().st_size / 4


def test_domain_types_come_out_as_they_went_in(log_path):
    with open_log(log_path) as log:
        statuses = list(log.statuses())
        assert len(statuses) == 21
        assert statuses[0].mode == Mode.TRACKING
        assert statuses[0].sensor == "pmd"
        assert len(list(log.odometry())) == 21
        parent, mount = log.extrinsics["pmd_optical"]
        assert parent == "chaser"
        np.testing.assert_allclose(mount.as_matrix(), T_CHASER_SENSOR.as_matrix(), atol=1e-12)


def test_the_parts_of_a_camera_frame_are_put_together_by_their_stamp(log_path):
    with open_log(log_path) as log:
        frames = list(pmd_frames(log, "pmd"))
        assert [frame.stamp_ns - EPOCH_NS for frame in frames] == [k * SECOND // 10 for k in range(21)]
        assert frames[0].depth_m.shape == frames[0].amplitude.shape == (12, 16)
        assert frames[0].camera.fx == 14.0


def test_frames_without_depth_are_left_out_and_the_others_stay_whole(tmp_path):
    path = SyntheticRun(unlogged=3).write(tmp_path / "run.mcap")
    with open_log(path) as log:
        frames = list(pmd_frames(log, "pmd"))
        assert [round((frame.stamp_ns - EPOCH_NS) / SECOND, 1) for frame in frames[:2]] == [0.0, 0.4]
        assert all(frame.amplitude is not None for frame in frames)


def test_frames_without_any_finite_depth_are_left_out(tmp_path):
    def blind(_pose, number):
        depth_m = np.full((12, 16), np.nan if number % 2 else 4.0, np.float32)
        return depth_m, np.zeros((12, 16), np.uint16)

    path = SyntheticRun(render=blind).write(tmp_path / "run.mcap")
    with open_log(path) as log:
        assert len(list(pmd_frames(log, "pmd"))) == 11


@pytest.mark.parametrize(("until_s", "with_amplitude"), [(0.0, 0), (0.55, 6)])
def test_an_amplitude_that_is_not_sent_is_not_waited_for(tmp_path, until_s, with_amplitude):
    path = SyntheticRun(amplitude_until_s=until_s).write(tmp_path / "run.mcap")
    with open_log(path) as log:
        frames = list(pmd_frames(log, "pmd"))
        assert len(frames) == 21
        assert sum(frame.amplitude is not None for frame in frames) == with_amplitude
        assert [frame.stamp_ns for frame in frames] == sorted(frame.stamp_ns for frame in frames)


def test_lidar_scans_keep_rows_and_columns(tmp_path):
    path = SyntheticRun(kind="lidar", name="front").write(tmp_path / "run.mcap")
    with open_log(path) as log:
        scans = list(lidar_scans(log, "front"))
        assert len(scans) == 21
        assert scans[0].organised
        assert scans[0].points_m.shape == (6, 8, 3)
        assert {name: sensor.kind for name, sensor in find_sensors(log).items()} == {"front": "lidar"}


def test_a_namespace_is_no_part_of_the_topics_names(tmp_path):
    path = SyntheticRun(namespace="lab/one").write(tmp_path / "run.mcap")
    with open_log(path) as log:
        assert "truth/odometry" in log.topics
        assert log.counts["truth/odometry"].written == log.topics["truth/odometry"].count
        assert read_run(log).errors.scored.all()


def test_configuration_and_counts_are_read_from_the_metadata(log_path):
    with open_log(log_path) as log:
        assert log.configuration["emulator"]["seed"] == 7
        assert log.counts["pmd/depth/image_raw"].written == 21
        assert log.metadata("nothing of that name") == {}


def test_parts_of_a_log_read_as_one_whatever_their_order(tmp_path, log_path):
    first = SyntheticRun(part=(-np.inf, 0.95)).write(tmp_path / "a.mcap")
    second = SyntheticRun(part=(0.95, np.inf)).write(tmp_path / "b.mcap")
    with open_log(second, first) as log, open_log(log_path) as whole:
        assert log.paths == (first, second)
        together = [(m.topic, m.log_ns, m.payload) for m in log.messages()]
        assert together == [(m.topic, m.log_ns, m.payload) for m in whole.messages()]
        assert log.counts.keys() == whole.counts.keys()


def one_line(error):
    return "\n" not in str(error.value) and len(str(error.value)) < 400


def test_a_missing_file_is_named_in_one_line(tmp_path):
    with pytest.raises(AnalysisError, match=r"gone\.mcap: no such file") as error:
        open_log(tmp_path / "gone.mcap")
    assert one_line(error)


def test_a_folder_without_a_log_is_named(tmp_path):
    with pytest.raises(AnalysisError, match=r"no \.mcap file in this folder") as error:
        open_log(tmp_path)
    assert one_line(error)


@pytest.mark.parametrize("content", [b"", b"bag", b"#ROSBAG V2.0\n" + bytes(100)])
def test_another_file_is_no_mcap_log(tmp_path, content):
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    with pytest.raises(AnalysisError, match=r"other\.mcap: is not an MCAP log") as error:
        open_log(path)
    assert one_line(error)


@pytest.mark.parametrize("size", [8, 500, -1, -100, -2000])
def test_a_truncated_log_is_sent_to_recovery(tmp_path, log_path, size):
    path = tmp_path / "cut.mcap"
    path.write_bytes(log_path.read_bytes()[:size])
    with pytest.raises(AnalysisError, match=r"cut\.mcap: the log is truncated; 'rpod recover") as error:
        open_log(path)
    assert one_line(error)


def damaged(log_path, tmp_path, start, *, size=64):
    data = bytearray(log_path.read_bytes())
    data[start : start + size] = bytes(size)
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("share", [0.1, 0.5, 0.8])
def test_a_damaged_log_is_sent_to_recovery(tmp_path, log_path, share):
    path = damaged(log_path, tmp_path, int(share * log_path.stat().st_size))
    with open_log(path) as log, pytest.raises(AnalysisError, match=r"damaged \(.+\); 'rpod recover") as error:
        list(log.messages())
    assert one_line(error)


def test_damage_anywhere_is_an_analysis_error_or_does_no_harm(tmp_path, log_path):
    size = log_path.stat().st_size
    for start in np.linspace(8, size - 72, 60).astype(int):
        try:
            with open_log(damaged(log_path, tmp_path, int(start))) as log:
                assert len(read_run(log).estimates) == 21
        except AnalysisError as error:
            assert "rpod recover" in str(error)  # noqa: PT017


def test_a_log_without_an_estimator_says_so(tmp_path):
    path = SyntheticRun(with_estimates=False).write(tmp_path / "silent.mcap")
    with open_log(path) as log, pytest.raises(AnalysisError, match="no estimates in the log") as error:
        read_run(log)
    assert one_line(error)


def test_a_failed_open_leaves_no_file_open(tmp_path, log_path):
    with pytest.raises(AnalysisError):
        open_log(log_path, tmp_path / "gone.mcap")  # an open stream would be a ResourceWarning, an error here


def test_a_run_that_never_tracked_is_read_all_the_same(tmp_path):
    path = SyntheticRun(frame=lambda *_: Frame(mode=Mode.ACQUIRING, reason="nothing")).write(
        tmp_path / "r.mcap"
    )
    with open_log(path) as log:
        run = read_run(log)
        assert (len(run.estimates), len(run.statuses)) == (0, 21)
