"""The view without a bus: it collects messages and draws the newest ones at each call.

The daemon and the view of a log both use it.
"""

import numpy as np
import rerun as rr
from scipy.spatial.transform import RigidTransform

from rpod_runtime import Received
from rpod_schemas.errors import MessageRejectedError
from rpod_target import NO_SYMMETRY, Target
from rpod_view.drawing import Drawing
from rpod_view.layout import SUMMARY, TIMELINE, Eye, layout, over_shoulder
from rpod_view.plots import Plots
from rpod_view.scene import Frame, Reject, Scene, Scored
from rpod_view.summary import summary

_RADIUS_M = 1.0
"""Radius of an unknown target."""


class View:
    """Collects messages and draws the newest.

    Args:
        recording: the recording to draw into.
        target: the target whose mesh and wireframe are drawn; None if it is not known.
        prefix: first part of the topics of the estimates.
        reject: function that is called for each message that cannot be used.
    """

    def __init__(
        self, recording: rr.RecordingStream, *, target: Target | None, prefix: str, reject: Reject
    ) -> None:
        self._recording, self._reject = recording, reject
        self._scene = Scene(prefix, target.equivalence if target else NO_SYMMETRY)
        self._drawing, self._plots = Drawing(recording, target), Plots(recording)
        self._scored: Scored | None = None
        self._radius_m = target.radius_m if target else _RADIUS_M
        self._images: dict[str, dict[str, tuple[int, int]]] = {}
        self._eye: Eye | None = None
        self._poses: tuple[object, ...] = ()
        """Source from which the poses were drawn."""
        self._summary = ""
        recording.send_blueprint(layout({}, None, self._radius_m))

    def take(self, received: Received) -> None:
        """Process a message."""
        try:
            self._scene.take(received)
        except MessageRejectedError as error:
            self._reject(received.topic.name, error)

    def draw(self, now_s: float | None = None) -> int:
        """Draw what has changed; return the number of frames drawn.

        Args:
            now_s: present time, clock of the arrivals; None stands for the last arrival.
        """
        statuses, scored = self._scene.statuses(), self._scene.estimated()
        self._plots.statuses(statuses)
        self._plots.integrities(self._scene.integrities())
        self._plots.estimates(scored)
        self._scored = scored[-1] if scored else self._scored
        frames = self._draw_frames()
        self._draw_poses(frames)
        self._draw_summary(now_s)
        return len(frames)

    def _draw_frames(self) -> list[Frame]:
        frames = []
        for frame in self._scene.frames(self._reject):
            self._arrange(frame)
            self._drawing.frame(frame, self._scene.estimate_at(frame.data.stamp_ns))
            frames.append(frame)
        return frames

    def _draw_poses(self, frames: list[Frame]) -> None:
        """Draw truth and estimate at the time of the newest frame or estimate, else of the newest truth."""
        scene = self._scene
        stamp_ns = max([frame.data.stamp_ns for frame in frames] + [scene.estimates.newest_ns])
        stamp_ns = scene.truth.newest_ns if stamp_ns < 0 else stamp_ns
        if stamp_ns < 0:
            return
        truth, estimate = scene.truth.at(stamp_ns), scene.estimate_at(stamp_ns)
        covariance = scene.newest.pose_covariance.tobytes() if scene.newest else None
        poses = (stamp_ns, _values(truth), _values(estimate), covariance, scene.integrity)
        if poses != self._poses:
            self._poses = poses
            self._drawing.poses(stamp_ns, truth, estimate, scene.newest)
            self._drawing.level(estimate, scene.integrity)

    def _draw_summary(self, now_s: float | None) -> None:
        """Draw the table at the newest known time."""
        scene = self._scene
        troubles = scene.troubles.values()
        stamp_ns = scene.known_ns
        if stamp_ns < 0:
            stamp_ns = max((each.stamp_ns for each in troubles), default=-1)
        text = summary(scene.status, self._scored, troubles, scene.integrity, scene.silent_s(now_s))
        if stamp_ns >= 0 and text != self._summary:
            self._summary = text
            self._recording.set_time(TIMELINE, timestamp=np.datetime64(stamp_ns, "ns"))
            self._recording.log(SUMMARY, rr.TextDocument(text, media_type="text/markdown"))

    def _arrange(self, frame: Frame) -> None:
        """Send the layout again if a camera is new, or if the direction of the eye has become known."""
        images, eye = dict(self._images), self._eye
        if shown := {
            image.title: (image.values.shape[1], image.values.shape[0]) for image in frame.data.images
        }:
            images[frame.sensor] = images.get(frame.sensor, {}) | shown
        if eye is None and frame.T_chaser_sensor is not None:
            eye = over_shoulder(frame.T_chaser_sensor)
        if images != self._images or eye is not self._eye:
            self._images, self._eye = images, eye
            self._recording.send_blueprint(layout(images, eye, self._radius_m))


def _values(pose: RigidTransform | None) -> bytes | None:
    return None if pose is None else pose.as_matrix().tobytes()
