"""Faults of sensors, played live before the check of drivers."""
