"""Returns of a scan: which rays give one, which are false, and how far others are from them."""
