"""Whether the pose of a search that took long is followed up to the present frame."""

from dataclasses import replace

from rpod_pose.measurement import Measurement
from rpod_pose.navigation.first_pose.following import Follow, kept
from rpod_pose.navigation.first_pose.searches import Found, Search
from rpod_pose.navigation.registering import Registrar
from rpod_pose.navigation.state import NavigatorState
from rpod_schemas.config.estimator import EstimatorSettings
from rpod_schemas.messages import NANOSECONDS
from rpod_schemas.types import Mode


class CatchingUp:
    """Keeps frames while a search runs, and decides whether its pose is followed through them.

    Frames are kept at times after which the attitude of a target with an unknown rate is vague.

    Args:
        settings: settings of the estimator.
        registrar: asks the methods of each sensor.
    """

    def __init__(self, settings: EstimatorSettings, registrar: Registrar) -> None:
        self._config, self._registrar = settings.filter, registrar
        vague_s = settings.navigator.tuning.vague_deg / settings.filter.initial_rate_sigma_deg_s
        self._apart_ns = round(vague_s * NANOSECONDS)

    def waited(self, search: Search, event: Measurement) -> Search:
        """Return a search that runs on while a frame of its sensor comes."""
        later = kept(search.later, event, since_ns=search.event.stamp_ns, apart_ns=self._apart_ns)
        return replace(search, waited=search.waited + 1, later=later)

    def needed(
        self, before: NavigatorState, begun: NavigatorState, search: Search, found: Found, event: Measurement
    ) -> Search | None:
        """Return what follows the pose of a search up to a frame; None if the frame verifies it itself.

        Args:
            before: state before the result of the search.
            begun: state after it, with a track if one began.
            search: the search, which has ended.
            found: its result.
            event: the present frame.
        """
        begins = begun.mode != before.mode and (begun.mode == Mode.VERIFYING or begun.mode.has_track)
        if not (begins and search.later and begun.history is not None):
            return None
        predicted = begun.history.at(event.stamp_ns, self._config)
        if predicted is None or self._registrar.is_confident(predicted):
            return None
        _, refusal = self._registrar.register(begun.joints, event, predicted, tracked=False)
        if not refusal:
            return None
        since = search.frames_from(found.stamp_ns(search))
        follow = Follow(found.acquisition, (*since, *search.later, event))
        return Search(event, follow=follow, angles=self._registrar.angles(begun.joints, event))
