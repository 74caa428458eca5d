"""What the random satellites and the shipped designs are made of: components, shapes, and their files."""
