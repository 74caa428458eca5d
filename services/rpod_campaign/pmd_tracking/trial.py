"""A trial of ``pmd-tracking``: a scenario's sequence of images, in the world that the estimator assumes."""

from rpod_campaign.pmd.sequence import SCHEMA, run

__all__ = ["SCHEMA", "run"]
