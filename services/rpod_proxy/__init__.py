"""A proxy between services and the router, which delays, slows, stalls and cuts their links on request."""
