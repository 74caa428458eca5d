"""Figures over a population of random satellites."""
