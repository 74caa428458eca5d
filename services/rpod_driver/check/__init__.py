"""The check of a live sensor against the interface control document, from the messages that it sent.

``Observer`` takes messages and keeps a few data of each; ``judge`` is a pure function of these data. So the
same check works for a sensor on the bus, for a recording, and for a driver in a test.
"""

from rpod_driver.check.judge import judge
from rpod_driver.check.observations import Observations, Observer, Options
from rpod_driver.check.result import CheckResult, Level

__all__ = ["CheckResult", "Level", "Observations", "Observer", "Options", "judge"]
