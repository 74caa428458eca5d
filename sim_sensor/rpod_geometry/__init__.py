"""Rays, lenses and what they meet of a target: for what emulates a sensor and for what estimates from it."""
