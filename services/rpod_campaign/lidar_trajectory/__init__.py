"""Template matching along the 2015 paper's safety ellipse."""
