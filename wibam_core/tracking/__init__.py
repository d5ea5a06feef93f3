"""Detections of all cameras to smoothed 7DoF tracks on the ground, and how good tracks are."""
