"""The likeliest pose near an aligned one, by the whole amplitude image and the depth."""
