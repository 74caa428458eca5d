"""A facility that stays up: ``rpod up`` starts its services, and starts again those that end."""
