"""Acquisitions find the target in one measurement without a guess (``ports.Acquisition``)."""
