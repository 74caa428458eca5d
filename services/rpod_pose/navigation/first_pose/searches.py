"""Searches that the navigator asks for, and the port by which it gets their results.

A search takes from a tenth of a second to many seconds; tracking must not wait for it. So the navigator asks
for it, goes on with other frames, and asks again at each frame of the same sensor until the result is there.
The result is about the searched frame: it is applied at that frame's stamp, and what follows from it is
verified by the present frame.

The port has three forms: ``InlineSearches`` here, for lockstep, campaigns and replay; one with processes of
its own, for a live daemon; and one that repeats a log. Given the frames at which results are there, the
navigator is a pure function.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol

from scipy.spatial.transform import RigidTransform

from rpod_pose.measurement import Measurement
from rpod_pose.navigation.first_pose.following import Follow, Placed, followed
from rpod_pose.ports import Acquisition, Angle, Methods, Registration
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.types import SensorFrame, Source

SEARCHING = "searching: the result of the frame {:.2f} s ago is awaited"
"""Reason for which a frame is not used while another one of its sensor is searched."""
SEARCHED = "searching: a search in this frame has begun"
"""Reason for which a frame is not used yet: it is searched."""
FOLLOWED = "searching: a pose found in an earlier frame is followed up to this one"
"""Reason for which a frame is not used yet: the pose of a search is followed through the frames since."""
FOUND = "a pose was found, which the next frame has to verify"
"""Reason for which the searched frame is not used yet if its sensor has sent no frame since."""
PAUSED = "not searched: no search has found the target, so fewer frames are searched"
"""Reason for which a frame is not searched."""
BEGUN = "search_begun"
"""Name of the evidence that a search in this frame has begun; its result comes with a later frame."""
AGE_S = "search_age_s"
"""Name of the evidence that a search's result was applied at this frame: age of the searched frame, s."""


class Near(NamedTuple):
    """The surroundings of a pose, which are searched first."""

    frame: SensorFrame
    """The frame as of its stamp."""
    T_sensor_target: RigidTransform


@dataclass(frozen=True, eq=False)
class Search:
    """A search in one frame."""

    event: Measurement
    """The searched frame."""
    frame: SensorFrame | None = None
    """Frame that is searched without a guess; None if only ``near`` is searched."""
    near: Near | None = None
    """Pose around which is searched first; None for none."""
    angles: Mapping[str, Angle] = field(default_factory=dict)
    """Expected angles of the target's joints, by name."""
    registration: Registration | None = None
    """Registration by the tracker in the frame; None if it was not asked."""
    reason: str = ""
    """Why the frame is not used if nothing is found near the pose."""
    beside_track: bool = False
    """Whether the target is tracked while it runs, so that it is less urgent than a tracked frame."""
    waited: int = 0
    """Number of frames of its sensor that have come since."""
    later: tuple[Measurement, ...] = ()
    """Some of these frames."""
    follow: Follow | None = None
    """Pose of an earlier search that is followed up to the frame, in place of a search; None for a search."""

    @property
    def sensor(self) -> str:
        """Name of the sensor."""
        return self.event.sensor

    @property
    def sent(self) -> "Search":
        """This search without the data that are needed only to use its result."""
        return replace(self, registration=None, later=())

    @property
    def report(self) -> str:
        """Reason for which the frame is not used yet."""
        return SEARCHED if self.follow is None else FOLLOWED

    def frames_from(self, stamp_ns: int) -> tuple[Measurement, ...]:
        """Return the frames from a stamp on through which a pose was followed up to the searched frame."""
        frames = (self.event,) if self.follow is None else self.follow.frames
        return tuple(frame for frame in frames if frame.stamp_ns >= stamp_ns)

    def age_s(self, stamp_ns: int) -> float:
        """Return the time from the searched frame to a stamp, s."""
        return (stamp_ns - self.event.stamp_ns) / NANOSECONDS


@dataclass(frozen=True, eq=False)
class Found:
    """Result of a search."""

    acquisition: Acquisition
    track: tuple[Placed, ...] = ()
    """Last two poses of one that was followed, each in its frame; the second is that of the acquisition."""
    nearby: bool = False
    """Whether it is that of the surroundings of ``Search.near``."""
    paused: bool = False
    """Whether the search was not made, because unsuccessful searches are limited."""

    def stamp_ns(self, search: Search) -> int:
        """Return the stamp of the frame in which the pose of this result of a search is."""
        return self.track[-1].stamp_ns if self.track else search.event.stamp_ns

    @classmethod
    def nothing(cls, reason: str) -> "Found":
        """Return the result of a search that found nothing, with the reason."""
        return cls(Acquisition(Registration.none(Source.NONE, reason)))

    @classmethod
    def not_searched(cls) -> "Found":
        """Return the result of a search that was not made because unsuccessful searches are limited."""
        return cls(Acquisition(Registration.none(Source.NONE, PAUSED)), paused=True)


class Searches(Protocol):
    """Makes searches, and returns each result once its search has ended."""

    def result(self, search: Search) -> Found | None:
        """Return the result of a search, which begins when it is asked for first; None while it runs."""
        ...

    def keep(self, searches: Collection[Search]) -> None:
        """Cancel all searches but these, because the results of the others are not needed."""
        ...


class InlineSearches:
    """Searches in the caller's thread.

    Args:
        methods: methods of each sensor, by its name.
        delay_frames: number of frames of the same sensor after which a result is there; 0 for at once.
    """

    def __init__(self, methods: Mapping[str, Methods], delay_frames: int = 0) -> None:
        self._methods, self._delay_frames = methods, delay_frames

    def result(self, search: Search) -> Found | None:
        """Return the result if enough frames have come since the searched one."""
        return find(search, self._methods[search.sensor]) if search.waited >= self._delay_frames else None

    def keep(self, searches: Collection[Search]) -> None:
        """Do nothing: no search runs between two frames."""


def find(search: Search, methods: Methods) -> Found:
    """Return the result of a search by the methods of its sensor."""
    if search.follow is not None:
        return Found(*followed(search.follow, expecting(methods, search.angles)))
    acquirer = expecting(methods, search.angles).acquirer
    if search.near is not None:
        found = acquirer.near(*search.near)
        if found.begins_track or search.frame is None:
            return Found(found, nearby=True)
    return Found(acquirer.acquire(search.frame))


def expecting(methods: Methods, angles: Mapping[str, Angle]) -> Methods:
    """Return the methods of a sensor where angles of the target's joints are expected, if any are."""
    return methods if methods.expecting is None or not angles else methods.expecting(angles)
