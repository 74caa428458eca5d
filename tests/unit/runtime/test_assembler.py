from hypothesis import given
from hypothesis import strategies as st

from rpod_runtime.assembler import Assembled, Assembler, NewestFrames

REQUIRED, OPTIONAL = frozenset({"depth", "camera_info"}), frozenset({"amplitude"})
PARTS = ("camera_info", "depth", "amplitude")


def assembler():
    return Assembler(REQUIRED, OPTIONAL)


def feed(assembler, *parts):
    """Hand in (name, stamp) pairs; return the frames in order, each part being its own name and stamp."""
    return [frame for name, stamp in parts for frame in assembler.add(name, stamp, (name, stamp))]


def stamps(frames):
    return [frame.stamp_ns for frame in frames]


def whole(stamp):
    return [(name, stamp) for name in PARTS]


def required(stamp):
    return [("camera_info", stamp), ("depth", stamp)]


def impatient():
    """Return an assembler that has given up waiting for the optional part, and the stamp that comes next."""
    patient = assembler()
    for stamp in range(1, 12):
        feed(patient, *required(stamp))
    return patient, 12


def test_a_frame_is_complete_with_all_its_parts():
    (frame,) = feed(assembler(), *whole(5))
    assert frame == Assembled(5, {name: (name, 5) for name in PARTS})


def test_required_parts_alone_are_not_complete_while_the_optional_one_may_come():
    assert feed(assembler(), *required(5)) == []


def test_a_single_part_is_a_frame_where_only_one_is_required():
    lidar = Assembler(frozenset({"points"}))
    assert stamps(feed(lidar, ("points", 1), ("points", 2))) == [1, 2]


def test_the_optional_part_is_not_waited_for_beyond_the_next_frames_first_part():
    frames = feed(assembler(), *required(5), ("camera_info", 6))
    assert stamps(frames) == [5]
    assert "amplitude" not in frames[0].parts


def test_an_older_frames_part_does_not_end_the_wait():
    waiting = assembler()
    assert feed(waiting, *required(5), ("camera_info", 4)) == []
    assert stamps(feed(waiting, ("amplitude", 5))) == [5]


def test_the_optional_part_is_waited_for_no_longer_where_it_does_not_come():
    patient, stamp = impatient()
    assert stamps(feed(patient, *required(stamp))) == [stamp]


def test_the_optional_part_is_waited_for_again_once_it_is_seen_behind_the_required_ones():
    patient, stamp = impatient()
    feed(patient, *whole(stamp))
    (frame,) = feed(patient, *whole(stamp + 1))
    assert "amplitude" in frame.parts


def test_an_optional_part_that_comes_after_the_next_frame_began_is_not_worth_the_wait():
    patient, stamp = impatient()
    feed(patient, *required(stamp), ("depth", stamp + 1), ("amplitude", stamp))
    assert stamps(feed(patient, ("camera_info", stamp + 1))) == [stamp + 1]


def test_the_frame_that_ends_the_wait_is_not_itself_complete_too_early():
    frames = feed(assembler(), *required(5), *whole(6))
    assert stamps(frames) == [5, 6]
    assert "amplitude" in frames[1].parts


def test_a_missing_required_part_leaves_its_frame_incomplete():
    lossy = assembler()
    assert stamps(feed(lossy, ("depth", 5), ("amplitude", 5), *whole(6))) == [6]
    assert lossy.incomplete == 1


def test_parts_of_a_frame_that_is_done_are_left_out():
    done = assembler()
    assert stamps(feed(done, *whole(5), *whole(6), *whole(5), *whole(6))) == [5, 6]
    assert done.incomplete == 0


def test_a_frame_that_comes_behind_a_newer_one_is_given_up_once():
    done = assembler()
    assert stamps(feed(done, *whole(5), *whole(4), *whole(4))) == [5]
    assert done.incomplete == 1


def test_the_late_parts_of_a_frame_that_was_given_up_are_not_counted_again():
    lossy = assembler()
    feed(lossy, ("depth", 5), *whole(6), ("camera_info", 5), ("amplitude", 5))
    assert lossy.incomplete == 1


def test_a_frame_whose_leading_part_was_refused_is_not_incomplete_as_well():
    refusing = Assembler(REQUIRED, OPTIONAL, leading="depth")
    feed(refusing, ("camera_info", 5))
    refusing.refuse(5)
    assert stamps(feed(refusing, ("amplitude", 5), *whole(6))) == [6]
    refusing.refuse(6)
    assert stamps(feed(refusing, *whole(7))) == [7]
    assert refusing.incomplete == 0


def test_interleaved_frames_come_out_oldest_first():
    frames = feed(
        assembler(), ("depth", 5), ("depth", 6), ("camera_info", 6), ("camera_info", 5), ("amplitude", 6)
    )
    assert stamps(frames) == [5, 6]


def test_frames_that_never_complete_do_not_pile_up():
    lossy = assembler()
    feed(lossy, *(("depth", stamp) for stamp in range(1, 101)))
    assert lossy.incomplete == 92
    assert stamps(feed(lossy, ("camera_info", 1), *whole(101))) == [101]


ARRIVALS = st.lists(
    st.tuples(st.sampled_from(PARTS), st.integers(0, 12)), max_size=60
)  # any order, gaps, duplicates


@given(ARRIVALS)
def test_whatever_the_order_no_frame_is_mispaired_doubled_or_out_of_order(arrivals):
    frames = feed(assembler(), *arrivals)
    for frame in frames:
        assert REQUIRED <= frame.parts.keys() <= REQUIRED | OPTIONAL
        assert all(part == (name, frame.stamp_ns) for name, part in frame.parts.items())
    assert stamps(frames) == sorted(set(stamps(frames)))


THREADS = st.lists(st.sampled_from(PARTS), min_size=60, max_size=60)  # whose turn it is


@given(THREADS)
def test_every_frame_is_complete_or_given_up_however_the_topics_run_ahead_of_each_other(turns):
    """Each topic keeps its order, as on the bus; among them there is none."""
    queues = {name: list(range(1, 21)) for name in PARTS}
    arrivals = [(name, queues[name].pop(0)) for name in turns if queues[name]]
    arrivals += [(name, stamp) for name in PARTS for stamp in queues[name]]
    collecting = assembler()
    frames = feed(collecting, *arrivals, ("depth", 99))
    assert len(frames) + collecting.incomplete == 20


@given(st.lists(st.permutations(PARTS), min_size=5, max_size=5))
def test_frames_whose_parts_come_in_any_order_lose_nothing_if_the_frames_come_in_turn(orders):
    arrivals = [(name, stamp) for stamp, order in enumerate(orders, start=1) for name in order]
    collecting = assembler()
    frames = feed(collecting, *arrivals)
    assert stamps(frames) == [1, 2, 3, 4, 5]
    assert all(frame.parts.keys() == set(PARTS) for frame in frames)
    assert collecting.incomplete == 0


def test_the_slot_keeps_the_newest_frame_and_tells_that_one_was_passed_over():
    slots = NewestFrames()
    assert not slots.put("pmd", Assembled(1, {}))
    assert slots.put("pmd", Assembled(2, {}))
    assert slots.take() == ("pmd", Assembled(2, {}))
    assert slots.take() is None
    assert not slots.put("pmd", Assembled(3, {}))


def test_sensors_have_a_slot_each_and_the_oldest_stamp_goes_first_then_the_name():
    slots = NewestFrames()
    for sensor, stamp in (("pmd", 2), ("lidar", 2), ("side", 1)):
        assert not slots.put(sensor, Assembled(stamp, {}))
    assert bool(slots)
    order = [slots.take()[0] for _ in range(3)]
    assert order == ["side", "lidar", "pmd"]
    assert not slots


def test_once_nothing_comes_any_more_a_frame_goes_without_its_optional_part():
    waiting = assembler()
    assert feed(waiting, *required(5), ("depth", 6)) == [Assembled(5, {n: (n, 5) for n, _ in required(5)})]
    assert waiting.release() == []
    assert feed(waiting, ("camera_info", 6)) == []
    assert stamps(waiting.release()) == [6]
    assert waiting.done_ns == 6


# --- parts that are valid until another comes, and stamps that differ a little ---


def lasting(within_ns=0):
    return Assembler(frozenset({"depth"}), frozenset(), frozenset({"camera_info"}), "depth", within_ns)


def test_a_lasting_part_serves_all_frames_until_another_comes():
    frames = feed(lasting(), ("depth", 1), ("depth", 2), ("camera_info", 2), ("depth", 3), ("camera_info", 4))
    frames += feed(camera := lasting(), ("camera_info", 2), ("depth", 3), ("camera_info", 4), ("depth", 5))
    assert [(frame.stamp_ns, frame.parts["camera_info"][1]) for frame in frames] == [
        (1, 2), (2, 2), (3, 2), (3, 2), (5, 4),
    ]  # fmt: skip
    assert camera.incomplete == 0


def test_where_each_frame_had_a_lasting_part_of_its_own_the_next_one_waits_for_it():
    camera = lasting()
    for stamp in range(1, 6):
        before = feed(camera, ("depth", stamp))
        after = feed(camera, ("camera_info", stamp))
        assert stamps(before + after) == [stamp]
    assert after[0].parts["camera_info"] == ("camera_info", 5)
    assert feed(camera, ("depth", 6)) == []
    assert stamps(feed(camera, ("depth", 7))) == [6, 7]  # not for ever, and no longer after one without


def near(within_ns):
    return Assembler(frozenset({"depth"}), frozenset({"amplitude"}), frozenset(), "depth", within_ns)


@given(st.lists(st.integers(-9, 9), min_size=6, max_size=6), st.booleans())
def test_parts_within_the_tolerance_are_one_frame_with_the_leading_parts_stamp(jitter, amplitude_first):
    arrivals = []
    for number, off in enumerate(jitter, start=1):
        pair = [("depth", 100 * number), ("amplitude", 100 * number + off)]
        arrivals += reversed(pair) if amplitude_first else pair
    camera = near(9)
    frames = feed(camera, *arrivals)
    assert stamps(frames) == [100, 200, 300, 400, 500, 600]
    pairs = [frame.parts["amplitude"][1] - frame.stamp_ns for frame in frames]
    assert pairs == jitter
    assert camera.incomplete == 0


def test_the_tolerance_never_exceeds_half_the_time_between_two_frames():
    camera = near(1_000)
    feed(camera, *((name, stamp) for stamp in (100, 200) for name in ("depth", "amplitude")))
    frames = feed(camera, ("depth", 300), ("amplitude", 360), ("depth", 400), ("amplitude", 400))
    assert "amplitude" not in frames[0].parts
    assert frames[1].parts["amplitude"] == ("amplitude", 360)
