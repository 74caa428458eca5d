"""``rpod calibrate``: what a laboratory calibrates from its logs."""
