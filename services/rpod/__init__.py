"""The command line and the local supervisor."""

__version__ = "0.1.0"
