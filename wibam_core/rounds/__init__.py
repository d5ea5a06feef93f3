"""Rounds of finding, fitting and teaching: what several cameras agree on teaches a network that finds more."""
