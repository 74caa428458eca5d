"""``rpod doctor``: measures what a host is fit for, and names the remedy where it is not."""
