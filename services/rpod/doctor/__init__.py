"""``rpod doctor``: what a host is fit for, measured, with what to do where it is not."""
