"""Calibrations refined from the traffic: what cameras see of the same vehicles says how they are held."""
