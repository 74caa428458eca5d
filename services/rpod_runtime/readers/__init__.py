"""The readers of the sensor kinds of the project."""
