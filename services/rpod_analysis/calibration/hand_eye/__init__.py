"""Hand-eye calibration: mount, holder and clock of a sensor, from its poses of a target and the truth."""
