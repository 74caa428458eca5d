"""Drivers in an environment and a process of their own, for libraries whose pins conflict with the project's.

``frame_pipe`` is the framing of what such a process sends, and all of the project that it needs.
"""

from rpod_driver.foreign.config import ProcessDevice
from rpod_driver.foreign.process import ForeignDriver

__all__ = ["ForeignDriver", "ProcessDevice"]
