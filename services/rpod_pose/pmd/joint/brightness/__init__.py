"""The brightness of the target in an image: what pixels show, its fit to the image, and its noise."""
