"""A first pose that is followed through the frames that came while it was searched for.

A search takes up to many seconds. Meanwhile a target that turns is far from where it was found, so that the
present frame does not verify the pose. Therefore some of the frames in between are kept, and the tracker
takes the pose from one to the next. It catches up if it takes less than the time between two of them.
"""

from dataclasses import replace
from typing import NamedTuple

from scipy.spatial.transform import RigidTransform

from rpod_pose.cancellation import stop_if_cancelled
from rpod_pose.measurement import Measurement
from rpod_pose.ports import Acquisition, Methods, Registration
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.poses import between
from rpod_schemas.types import SensorFrame

MOST_KEPT = 64
"""Greatest number of frames that are kept. Numerics: a budget of memory, 150 MB of images of 848 x 480
pixels."""
NOT_FOLLOWED = "the pose found in the frame {:.2f} s before is not followed to this one: {}"
"""Reason for which the pose of a search is not used."""


class Follow(NamedTuple):
    """A pose and the frames through which it is followed."""

    found: Acquisition
    """Result of the search, with a pose."""
    frames: tuple[Measurement, ...]
    """The searched frame, and later ones of the same sensor in the order of their stamps, at least one."""


class Placed(NamedTuple):
    """The pose of the target in a frame."""

    stamp_ns: int
    registration: Registration
    """A registration with a pose."""

    @property
    def pose(self) -> RigidTransform:
        """T_sensor_target."""
        assert self.registration.T_sensor_target is not None  # noqa: S101 - see the field
        return self.registration.T_sensor_target


class Followed(NamedTuple):
    """Result of following a pose."""

    acquisition: Acquisition
    """The pose in the last frame that shows it; without a pose if none does, with the reason."""
    track: tuple[Placed, ...] = ()
    """The pose in the last two frames that show it, which give the target's velocity."""


def kept(
    frames: tuple[Measurement, ...], event: Measurement, *, since_ns: int, apart_ns: int
) -> tuple[Measurement, ...]:
    """Return the kept frames with one more, if it is late enough.

    Where they are too many, every second one is left out, and later ones are farther apart.

    Args:
        frames: frames that are kept already, in the order of their stamps.
        event: a frame of the same sensor.
        since_ns: stamp of the searched frame.
        apart_ns: least time between two frames.
    """
    last_ns = frames[-1].stamp_ns if frames else since_ns
    usual_ns = (last_ns - since_ns) // len(frames) if frames else 0
    if event.stamp_ns - last_ns < max(apart_ns, usual_ns):
        return frames
    more = (*frames, event)
    return more if len(more) <= MOST_KEPT else more[1::2]


def followed(follow: Follow, methods: Methods) -> Followed:
    """Return a found pose in the last of some frames that shows it.

    Each frame is registered from where the target would be if it went on as between the last two poses. A
    frame that gives no pose is left out.
    """
    searched, *later = follow.frames
    registration = follow.found.registration
    track = [Placed(searched.stamp_ns, registration)]
    for event in later:
        stop_if_cancelled()
        registration = _registered(event, track[-2:], methods)
        if registration.continues_track:
            track.append(Placed(event.stamp_ns, registration))
    last = track[-1].registration
    if len(track) > 1 and last.begins_track:
        return Followed(replace(follow.found, registration=last), tuple(track[-2:]))
    age_s = (follow.frames[-1].stamp_ns - searched.stamp_ns) / NANOSECONDS
    reason = NOT_FOLLOWED.format(age_s, registration.belief.refusal)
    return Followed(replace(follow.found, registration=Registration.none(registration.source, reason)))


def _registered(event: Measurement, track: list[Placed], methods: Methods) -> Registration:
    """Return the registration of a frame from the pose to which the last one or two poses lead."""
    first, last = track[0].pose, track[-1].pose
    if len(track) == 1:
        return methods.tracker.track(event.data, first)
    took_ns = track[1].stamp_ns - track[0].stamp_ns
    predicted = between(first, last, (event.stamp_ns - track[0].stamp_ns) / took_ns)
    frame: SensorFrame = event.data
    if methods.deskew is not None:
        per_s = NANOSECONDS / took_ns
        frame = methods.deskew(
            frame,
            predicted,
            velocity_m_s=per_s * (last.translation - first.translation),
            rate_rad_s=per_s * (last.rotation * first.rotation.inv()).as_rotvec(),
        )
    return methods.tracker.track(frame, predicted)
