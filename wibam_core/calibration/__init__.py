"""Cameras from what a user measured, and how well they fit."""
