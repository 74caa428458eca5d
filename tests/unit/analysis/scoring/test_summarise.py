import json
import re
from pathlib import Path

import numpy as np
import pytest
from synthetic_log import Frame, SyntheticRun

import rpod_schemas
from rpod_analysis import open_log, stream_run
from rpod_analysis.errors import FramesDifferError
from rpod_analysis.log import Logged, accounting
from rpod_analysis.log.accounting import Account, SensorFlow
from rpod_analysis.scoring.run_checks import assess, find_checks
from rpod_analysis.scoring.summarise import summarise
from rpod_schemas.poses import make_pose
from rpod_schemas.summary import LogCompleteness, Summary
from rpod_schemas.types import Diagnostic, Health, Mode


def summary_of(tmp_path, **options):
    path = SyntheticRun(**options).write(tmp_path / "run.mcap")
    with open_log(path) as log:
        return summarise(log, stream_run(log), report=tmp_path / "report.html")


def failing(summary, alarms=0):
    return {check.question for check in find_checks(summary, alarms) if check.good is False}


def test_injected_errors_come_back_exactly(tmp_path):
    turn, shift = np.array([0.01, -0.02, 0.03]), np.array([0.02, 0.05, -0.1])
    error = summary_of(tmp_path, frame=lambda *_: Frame(attitude_rad=turn, position_m=shift)).error
    assert error is not None
    assert error.attitude_deg.max == pytest.approx(np.rad2deg(np.linalg.norm(turn)))
    assert (error.roll_deg_rms, error.pitch_deg_rms, error.yaw_deg_rms) == pytest.approx(
        tuple(np.rad2deg(np.abs(turn)))
    )
    assert error.position_m.rms == pytest.approx(np.linalg.norm(shift))
    assert (error.x_m_rms, error.y_m_rms, error.z_m_rms) == pytest.approx(tuple(np.abs(shift)))


def test_each_frame_is_counted_once_under_what_became_of_it(tmp_path):
    def frame(number, _time_s):
        if number < 3:
            return Frame(mode=Mode.ACQUIRING, reason="not believed: cost 0.2 m2")
        if number < 5:
            return Frame(mode=Mode.VERIFYING)
        if 10 <= number < 14:
            return Frame(mode=Mode.LOST, reason="gate: nis 80.0")
        return Frame(reason="gate: nis 30.0" if number == 7 else "")

    summary = summary_of(tmp_path, frame=frame, dropped=5)
    counts = summary.estimates
    assert (counts.count, counts.accepted, counts.rejected, counts.dropped) == (12, 13, 8, 5)
    assert counts.lost_s == pytest.approx(0.4)
    assert summary.modes.first_tracking_s == pytest.approx(0.5 + 2 / 250)
    assert summary.modes.tracking_share == pytest.approx(12 / 16)
    assert summary.modes.tracked_time_share == pytest.approx(11 / 20)
    assert summary.modes.longest_untracked_s == pytest.approx(0.5)


def test_estimates_in_a_gap_of_the_truth_are_unscored_and_counted(tmp_path):
    def frame(number, _time_s):
        return Frame(position_m=(9.0, 0.0, 0.0) if number == 5 else (0.0, 0.0, 0.0))

    summary = summary_of(tmp_path, frame=frame, truth_gaps_s=((0.49, 0.51),))
    assert summary.estimates.unscored == 1
    assert summary.error is not None
    assert summary.error.position_m.max < 1e-6


def test_the_share_worse_than_the_limits_is_of_the_tracked_frames(tmp_path):
    summary = summary_of(tmp_path, frame=lambda k, _: Frame(position_m=(0.31 if k < 7 else 0.0, 0, 0)))
    assert summary.modes.worse_than_10deg_or_0_3m_share == pytest.approx(7 / 21)
    assert "Accuracy" in failing(summary)


def test_latency_is_from_the_stamp_to_the_publication(tmp_path):
    summary = summary_of(tmp_path, frame=lambda k, _: Frame(latency_s=0.2 if k == 3 else 0.05))
    assert summary.latency_s is not None
    assert summary.latency_s.p50 == pytest.approx(0.05)
    assert summary.latency_s.max == pytest.approx(0.2)


def test_latency_is_to_the_first_estimate_where_a_late_frame_improves_it(tmp_path):
    summary = summary_of(tmp_path, frame=lambda _k, _: Frame(latency_s=0.05, again_s=0.3))
    assert summary.latency_s is not None
    assert summary.latency_s.max == pytest.approx(0.05)
    assert summary.estimates.count == 2 * 21


def test_latency_is_null_where_the_clock_is_not_the_walls_and_processing_is_not(tmp_path):
    summary = summary_of(tmp_path, clock=True)
    assert summary.latency_s is None
    assert summary.processing_s is not None
    assert summary.processing_s.p50 == pytest.approx(0.03)


def test_without_truth_errors_are_null_and_all_estimates_unscored(tmp_path):
    summary = summary_of(tmp_path, with_truth=False)
    assert summary.error is None
    assert summary.consistency is None
    assert summary.estimates.unscored == summary.estimates.count == 21
    assert {check.good for check in find_checks(summary, 0) if check.question == "Accuracy"} == {None}


def test_a_run_that_never_tracked_has_nulls_and_a_result(tmp_path):
    summary = summary_of(tmp_path, frame=lambda *_: Frame(mode=Mode.ACQUIRING, reason="nothing found"))
    assert (summary.modes.first_tracking_s, summary.error, summary.latency_s) == (None, None, None)
    assert summary.estimates.lost_s == 0.0
    assert assess(find_checks(summary, 0)) == "The target was not acquired."


def test_messages_that_did_not_reach_the_log_are_missed(tmp_path):
    frames = summary_of(tmp_path, unlogged=4).frames
    depth = frames["pmd/depth/image_raw"]
    assert (depth.published, depth.logged, depth.missed) == (21, 17, 4)
    assert sum(count.missed for count in frames.values()) == 4


def test_a_good_run_is_called_so_and_a_bad_one_by_its_findings(tmp_path):
    good = summary_of(tmp_path)
    assert failing(good) == set()
    assert assess(find_checks(good, 0)) == "The run passed all checks."
    assert assess(find_checks(good, 2)) == "The run has findings: services."
    assert failing(summary_of(tmp_path, unlogged=1, dropped=9)) == {"Log", "Completeness", "Dropped frames"}


def test_the_mean_and_the_share_of_nis_are_of_all_frames_that_have_one(tmp_path):
    nis = {3: 20.0, 4: 1.0, 5: 12.59}
    summary = summary_of(tmp_path, frame=lambda k, _: Frame(nis=nis.get(k, float("nan"))))
    assert summary.innovation is not None
    assert summary.innovation.nis_mean == pytest.approx(33.59 / 3)
    assert summary.innovation.nis_share_in_95 == pytest.approx(2 / 3)
    assert summary_of(tmp_path).innovation is None


def test_what_the_log_says_of_itself_stands_in_the_summary(tmp_path):
    assert summary_of(tmp_path).completeness == LogCompleteness(complete=True, reasons=())
    said = summary_of(tmp_path, unlogged=3).completeness
    assert said == LogCompleteness(complete=False, reasons=("/pmd/depth/image_raw: 3 missed on the bus",))
    assert summary_of(tmp_path, states_completeness=False).completeness.complete is None


def test_scenario_and_seed_come_from_the_services_configuration(tmp_path):
    summary = summary_of(tmp_path)
    assert (summary.scenario, summary.seed) == ("synthetic-approach", 7)
    assert summary.duration_s == pytest.approx(2.016)


@pytest.mark.parametrize(("of_truth", "of_estimates"), [("chaser", "servicer"), ("workshop", "chaser")])
def test_frames_of_reference_that_differ_are_an_error_with_a_topic_of_each(
    tmp_path, monkeypatch, of_truth, of_estimates
):
    monkeypatch.setattr("synthetic_log.CHASER", of_truth)
    truth = SyntheticRun(with_estimates=False).write(tmp_path / "truth.mcap")
    monkeypatch.setattr("synthetic_log.CHASER", of_estimates)
    path = SyntheticRun(with_truth=False).write(tmp_path / "run.mcap")
    with open_log(path, truth) as log, pytest.raises(FramesDifferError) as raised:
        stream_run(log)
    assert f"truth/odometry in frame {of_truth!r}" in str(raised.value)
    assert f"estimate/odometry in frame {of_estimates!r}" in str(raised.value)


def icd_fields():
    """The ICD's sentence on summary.json as nested dictionaries, ``<topic>`` standing for any."""
    text = (Path(rpod_schemas.__file__).parents[1] / "ICD.md").read_text("utf-8")
    sentence = re.search(r"`summary\.json` \(and.*?holds at least: (.*?)\.\n", text, re.DOTALL).group(1)
    items = ", ".join(re.findall(r"`([^`]+)`", sentence))
    names = re.sub(r"(<topic>|\w+)(:?)", lambda name: f'"{name[1]}": {"" if name[2] else "null"}', items)
    return json.loads(f"{{{names}}}")


def missing(fields, document):
    """Dotted names that the document lacks."""
    names = []
    for name, inner in fields.items():
        key = next(iter(document)) if name == "<topic>" else name
        if key not in document:
            names.append(name)
        elif inner:
            names += [f"{name}.{deeper}" for deeper in missing(inner, document[key])]
    return names


def test_summary_json_has_every_field_of_the_icd(tmp_path):
    summary = summary_of(tmp_path, frame=lambda *_: Frame(covariance=np.eye(6) * 1e-4))
    document = json.loads(summary.model_dump_json())
    fields = icd_fields()
    assert fields["frames"]["<topic>"].keys() == {"published", "logged", "missed"}
    assert fields["error"]["attitude_deg"].keys() == {"rms", "p95", "max"}
    assert missing(fields, document) == []
    assert missing(fields, {"frames": {"t": {}}, "seed": 1})
    assert Summary.model_validate(document) == summary


def test_numbers_that_are_not_known_are_null_in_json(tmp_path):
    text = summary_of(tmp_path, with_truth=False, clock=True).model_dump_json()
    assert "NaN" not in text
    assert json.loads(text)["latency_s"] is None


def message(topic, sequence):
    return Logged(topic, "std_msgs/msg/Header", 0, 0, sequence, b"")


def heartbeat(name, **values):
    values = {key.replace("__", "/"): str(value) for key, value in values.items()}
    return Diagnostic(stamp_ns=0, name=name, level=Health.OK, message="", values=values)


def test_counters_without_end_are_bounded_and_those_that_are_known_go_on(monkeypatch):
    monkeypatch.setattr(accounting, "_MOST_COUNTERS", 10)
    account = Account()
    account.take_diagnostic(heartbeat("motion", published__clock=1))
    for number in range(50):
        account.take_diagnostic(heartbeat(f"liar{number}", **{f"a{number}": 1, f"b{number}": 1}))
    account.take_diagnostic(heartbeat("motion", published__clock=7))
    assert sum(map(len, account.counters.values())) == 10
    assert len(account.counters) < 10
    assert account.counters["motion"]["published/clock"] == 7


def test_without_a_counter_the_highest_sequence_number_is_what_was_published():
    account = Account()
    for sequence in (1, 2, 5):
        account.take(message("camera/points", sequence))
    count = account.frames()["camera/points"]
    assert (count.published, count.logged, count.missed) == (5, 3, 2)


def test_what_a_publisher_sent_long_before_the_log_is_not_missed():
    account = Account()
    for sequence in range(100_001, 100_011):
        account.take(message("pmd/camera_info", sequence))
    account.take_diagnostic(heartbeat("driver", published__pmd__camera_info=100_011))
    count = account.frames()["pmd/camera_info"]
    assert (count.published, count.logged, count.missed) == (11, 10, 1)


def of_publisher(topic, sequence, gid, *, publish_s, log_s, session="session"):
    return Logged(
        topic, "std_msgs/msg/Header", int(log_s * 1e9), int(publish_s * 1e9), sequence, b"", gid, session
    )


def test_a_log_that_begins_in_the_middle_counts_from_its_first_message_on_each_publisher():
    account = Account()
    account.take(of_publisher("pmd/depth", 60, "a", publish_s=9.9, log_s=10.0))
    for sequence in (63, 64, 66):  # the session's info keeps nothing for a logger that comes later
        account.take(of_publisher("pmd/info", sequence, "b", publish_s=10.1, log_s=10.2))
    for number in range(916, 920):
        account.take(of_publisher("status", number, "c", publish_s=9.0, log_s=10.3, session="killed"))
    account.take_diagnostic(heartbeat("estimator", published__status=919))
    for number in (1, 2, 4):
        account.take(of_publisher("status", number, "d", publish_s=11.0, log_s=11.1, session="started again"))
    account.take_diagnostic(heartbeat("estimator", published__status=4))
    counts = account.frames()
    assert (counts["pmd/info"].published, counts["pmd/info"].missed) == (4, 1)
    assert (counts["status"].published, counts["status"].missed) == (8, 1)


def test_a_publisher_that_begins_while_the_log_is_open_has_missed_its_first_messages():
    account = Account()
    account.take(of_publisher("truth", 1, "a", publish_s=10.0, log_s=10.0, session="other"))
    account.take(of_publisher("status", 3, "b", publish_s=12.0, log_s=12.1))
    assert account.frames()["status"].missed == 2


def test_a_message_after_the_last_counters_of_a_killed_publisher_counts_as_published():
    account = Account()
    for number in (1, 2, 4, 5):
        account.take(of_publisher("status", number, "a", publish_s=10.0, log_s=10.0))
    account.take_diagnostic(heartbeat("estimator", published__status=2))
    assert (account.frames()["status"].published, account.frames()["status"].missed) == (5, 1)


def test_of_messages_that_name_no_publisher_the_loggers_record_tells_where_each_begins():
    account = Account()
    account.numbering.recorded_before = {"tf": 915 + 263, "status": 70}
    for number in (916, 917, 264, 1):
        account.take(message("tf", number))
    account.take(of_publisher("status", 71, "a", publish_s=12.0, log_s=12.0))
    account.take_diagnostic(heartbeat("estimator", published__tf=917))
    account.take_diagnostic(heartbeat("motion", published__tf=264))
    account.take_diagnostic(heartbeat("estimator", published__tf=2))
    count = account.frames()["tf"]
    assert (count.published, count.logged, count.missed) == (5, 4, 1)


def test_the_counters_of_several_publishers_and_of_a_restarted_one_add_up():
    account = Account()
    for sequence in (1, 2, 3, 1, 1, 2):
        account.take(message("tf", sequence))
    for service, value in (("motion", 2), ("motion", 3), ("estimator", 1), ("motion", 1), ("motion", 2)):
        account.take_diagnostic(heartbeat(service, published__tf=value))
    assert account.frames()["tf"].published == 6


def test_only_the_estimator_whose_status_it_is_has_dropped_frames():
    account = Account()
    account.take_diagnostic(
        heartbeat("a", published__estimate__status=9, dropped__pmd=3, dropped__lidar=1, dropped=4)
    )
    account.take_diagnostic(heartbeat("b", published__other__status=9, dropped__pmd=50))
    account.take_diagnostic(heartbeat("logger", dropped=70))
    assert account.dropped("estimate/status") == 4
    assert account.dropped("other/status") == 50


def test_a_frame_that_never_became_complete_is_dropped_too():
    account = Account()
    account.take_diagnostic(heartbeat("a", published__estimate__status=9, dropped__pmd=3, incomplete__pmd=2))
    assert account.dropped("estimate/status") == 5


def test_a_command_that_a_service_accepted_is_told_once_with_its_request():
    account = Account()
    for count in (0, 1, 1, 2):
        values = {"commands/reset": str(count), "command/reset": f'{{"pose": {count}}}'} if count else {}
        account.take_diagnostic(
            Diagnostic(stamp_ns=count, name="estimator", level=Health.OK, message="", values=values)
        )
    assert [(c.stamp_ns, c.service, c.verb, c.request) for c in account.commands] == [
        (1, "estimator", "reset", '{"pose": 1}'), (2, "estimator", "reset", '{"pose": 2}'),
    ]  # fmt: skip


def test_alarms_are_counted_by_what_they_say():
    account = Account()
    for level, message in ((Health.ERROR, "disk full"), (Health.ERROR, "disk full"), (Health.WARN, "slow")):
        account.take_diagnostic(
            Diagnostic(stamp_ns=0, name="logger", level=level, message=message, values={})
        )
    assert account.alarms == {"logger: disk full": 2}


def test_an_alarm_with_other_figures_is_the_same_alarm():
    account = Account()
    for age in ("1.200", "1.300"):
        message = f"pmd: no frame used: late: {age} s old"
        account.take_diagnostic(
            Diagnostic(stamp_ns=0, name="e", level=Health.ERROR, message=message, values={})
        )
    assert account.alarms == {"e: pmd: no frame used: late: … s old": 2}


def test_what_became_of_a_sensors_frames_is_read_from_the_estimators_diagnostics():
    account = Account()
    for number in (1, 2):
        values = {
            "published/estimate/status": "9",
            "inputs/pmd/used": str(number),
            "inputs/pmd/not_used/late": str(2 * number),
            "input/pmd/late": f"late: {number}.000 s old",
        }
        account.take_diagnostic(
            Diagnostic(stamp_ns=0, name="estimator", level=Health.OK, message="", values=values)
        )
    inputs = account.inputs("estimate/status")
    assert {sensor: each.model_dump() for sensor, each in inputs.items()} == {
        "pmd": {"used": 2, "not_used": {"late": {"frames": 4, "last": "late: 2.000 s old"}}}
    }
    assert account.inputs("other/status") == {}


def test_every_frame_of_a_sensor_is_told_of_once():
    flow = SensorFlow("pmd", published=20, accepted=10, rejected=3, dropped=4, incomplete=1)
    assert flow.rest == 2


def test_the_error_at_a_frame_of_the_target_holds_the_lever_arm(tmp_path):
    mirror = make_pose(translation_m=(0.0, 2.0, 0.0))
    target = {
        "name": "brick",
        "mass_kg": 1.0,
        "materials": {"grey": {"reflectivity": 0.5, "diffuse": 0.4, "f0": 0.02, "roughness": 0.3}},
        "parts": [{"name": "block", "shape": "box", "size_m": [1.0, 1.0, 1.0], "material": "grey"}],
        "distance_field": {"spacing_m": 0.2},
        "frames": {"mirror": {"translation_m": [0.0, 2.0, 0.0]}},
    }
    file = tmp_path / "brick.yaml"
    file.write_text(json.dumps(target))
    turned = Frame(attitude_rad=(0.01, 0.0, 0.0))
    summary = summary_of(tmp_path, frame=lambda *_: turned, target=str(file), frames={"mirror": mirror})
    assert summary.model == str(file)
    assert summary.frame_errors["mirror"].position_m.rms == pytest.approx(0.02, rel=1e-3)
    assert summary.frame_errors["mirror"].attitude_deg.rms == pytest.approx(np.rad2deg(0.01))
