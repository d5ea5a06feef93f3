"""Calibrations and surveyed points as other programs write them: one module a format, listed in `registry`."""
