"""Configuration models: frozen, closed, checked, with units in the names.

Each service has one; a scenario holds what they share. Loaded once at the edge.
"""
