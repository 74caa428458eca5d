"""Replay of a log: through the navigator in one process, onto the bus, or into the view."""

from rpod_analysis.replay.compare import Compared, compare
from rpod_analysis.replay.navigate import Replayed, configured_estimator, replay
from rpod_analysis.replay.playback import Playback, Played, play

__all__ = ["Compared", "Playback", "Played", "Replayed", "compare", "configured_estimator", "play", "replay"]
