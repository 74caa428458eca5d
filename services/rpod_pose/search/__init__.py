"""What the search of every sensor needs: attitude grids, energies, hypotheses, verified candidates."""
