"""The check of a live sensor against the interface control document, from the messages that it sent.

``Observer`` takes messages and keeps little of each; ``judge`` is a pure function of what it kept. So the
same check holds for a sensor on the bus, a recording, and a driver in a test.
"""

from rpod_driver.check.judge import judge
from rpod_driver.check.observations import Observations, Observer, Options
from rpod_driver.check.result import CheckResult, Level

__all__ = ["CheckResult", "Level", "Observations", "Observer", "Options", "judge"]
