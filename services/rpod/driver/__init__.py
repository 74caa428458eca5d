"""``rpod driver``: runs the driver of a sensor, and checks a live sensor."""
