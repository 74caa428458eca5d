"""Drivers in an environment and a process of their own, for libraries whose pins conflict with the project's.

``frame_pipe`` is the framing of the messages of such a process, and the only part of the project that it
needs.
"""

from rpod_driver.foreign.config import ProcessDevice
from rpod_driver.foreign.process import ForeignDriver

__all__ = ["ForeignDriver", "ProcessDevice"]
