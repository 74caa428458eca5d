"""Building blocks of the random satellites and the shipped designs: components, shapes, and their files."""
