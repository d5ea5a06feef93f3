"""Simulated sites: traffic, renderer and recorder, with the exact truth."""
