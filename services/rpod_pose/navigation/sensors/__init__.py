"""Several sensors on one track: what each has seen, where each is used, and how one joins the others."""
