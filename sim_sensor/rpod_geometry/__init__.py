"""Rays, lenses and what they meet of a target: for what emulates a sensor and for what estimates from it."""

from rpod_schemas.kernel_cache import watch_callees

watch_callees()
