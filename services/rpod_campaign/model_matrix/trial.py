"""The trials are those of ``population``: one scan or frame of the target, with or without a guess."""

from rpod_campaign.population.trial import SCHEMA, PopulationCell, run

__all__ = ["SCHEMA", "PopulationCell", "run"]
