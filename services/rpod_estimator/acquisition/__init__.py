"""Acquisitions: they find the target in one measurement without a guess (``ports.Acquisition``). No bus, no clock."""
