"""The sensor emulator: truth in, sensor messages out."""
