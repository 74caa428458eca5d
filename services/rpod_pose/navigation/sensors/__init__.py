"""Several sensors on one track: frames and distances of each, and how one joins the others."""
