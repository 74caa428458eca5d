"""Pose estimation: from a measurement to an accepted pose and a navigated state.

The functions are pure and use no bus, no clock and no log, so the daemon, a replay and a campaign run the
same code.
"""

from rpod_schemas.caches.kernels import watch_callees

watch_callees()
