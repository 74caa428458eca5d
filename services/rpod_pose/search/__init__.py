"""Tools shared by the searches of all sensors: attitude grids, energies, hypotheses, verified candidates."""
