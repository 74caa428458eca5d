"""Searches that the navigator requests, and the port through which it gets their results.

A search takes from a tenth of a second to many seconds; tracking must not wait for it. So the navigator
requests it, processes further frames, and asks for the result at each frame of the same sensor until it is
available. The result belongs to the searched frame: it is applied at that frame's stamp, and the present
frame verifies the pose that follows from it.

The port has three implementations: ``InlineSearches`` here, for lockstep, campaigns and replay; one with
processes of its own, for a live daemon; and one that repeats the searches of a log. If it is given at which
frames the results arrive, the navigator is a pure function.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol

from scipy.spatial.transform import RigidTransform

from rpod_pose.belief import Angle
from rpod_pose.measurement import Measurement
from rpod_pose.navigation.first_pose.following import Follow, Placed, followed
from rpod_pose.ports import Acquisition, Methods, Registration
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
    """A pose near which is searched first."""

    frame: SensorFrame
    """The frame at its stamp, de-skewed if the sensor kind needs it."""
    T_sensor_target: RigidTransform


@dataclass(frozen=True, eq=False)
class Search:
    """A search in one frame."""

    event: Measurement
    """The searched frame."""
    frame: SensorFrame | None = None
    """Frame that is searched without a guess; None if only ``near`` is searched."""
    near: Near | None = None
    """Pose near which is searched first; None for a search without a guess only."""
    angles: Mapping[str, Angle] = field(default_factory=dict)
    """Expected angles of the target's joints, by name."""
    registration: Registration | None = None
    """Registration of the frame by the tracker; None if there was none."""
    reason: str = ""
    """Why the frame is not used if nothing is found near the pose."""
    beside_track: bool = False
    """Whether the target is tracked while the search runs, which is then less urgent than tracked frames."""
    waited: int = 0
    """Number of frames of the same sensor that have arrived since the searched one."""
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
        """This search as it is sent to a search process, without data that only its result needs."""
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
    """Whether it is the result of the search near ``Search.near``."""
    paused: bool = False
    """Whether the frame was not searched, because the number of unsuccessful searches is limited."""

    def stamp_ns(self, search: Search) -> int:
        """Return the stamp of the frame in which the pose of this result of a search is."""
        return self.track[-1].stamp_ns if self.track else search.event.stamp_ns

    @classmethod
    def nothing(cls, reason: str) -> "Found":
        """Return the result of a search that found nothing, with the reason."""
        return cls(Acquisition(Registration.none(Source.NONE, reason)))

    @classmethod
    def not_searched(cls) -> "Found":
        """Return the result for a frame that was not searched, as unsuccessful searches are limited."""
        return cls(Acquisition(Registration.none(Source.NONE, PAUSED)), paused=True)


class Searches(Protocol):
    """Runs searches, and returns each result when its search has ended."""

    def result(self, search: Search) -> Found | None:
        """Return the result of a search, or None while it runs; the first call starts the search."""
        ...

    def keep(self, searches: Collection[Search]) -> None:
        """Cancel all searches except these; the results of the others are not needed."""
        ...


class InlineSearches:
    """Searches in the caller's thread.

    Args:
        methods: methods of each sensor, by its name.
        delay_frames: number of frames of the same sensor after which a result is available; 0 for at once.
    """

    def __init__(self, methods: Mapping[str, Methods], delay_frames: int = 0) -> None:
        self._methods, self._delay_frames = methods, delay_frames

    def result(self, search: Search) -> Found | None:
        """Return the result if enough frames have arrived since the searched one; otherwise None."""
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
    """Return the methods of a sensor for expected angles of the target's joints, if there are any."""
    return methods if methods.expecting is None or not angles else methods.expecting(angles)
