"""Adapters of real devices, one folder each. A device's library is imported only by its own driver."""
