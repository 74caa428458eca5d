"""Drafting of a parameter file from a CAD file."""
