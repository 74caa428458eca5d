"""``rpod target``: a parameter file from a CAD file, and the check of a target."""
