"""The way from accepted poses to a state: navigator, filter, history of measurements, de-skewing."""
