"""``rpod run``: plays a scenario through the services as processes on this machine."""
