"""Trackers: they register one measurement from a predicted pose (``ports.Tracker``). No bus, no clock."""
