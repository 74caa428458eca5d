"""From measured poses to a navigated state: navigator, filter, history of measurements, de-skewing."""
