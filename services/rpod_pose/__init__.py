"""From a measurement to a believed pose and a navigated state.

Pure: no bus, no clock and no log, so that the daemon, a replay and a campaign run the same functions.
"""

from rpod_schemas.kernel_cache import watch_callees

watch_callees()
