"""A sensor kind of rpod that comes from outside: a monocular camera and a tracker by edges."""
