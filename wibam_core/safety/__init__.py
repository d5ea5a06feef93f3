"""Surrogate safety measures on oriented footprints, one a module, and the conflicts that some of them find."""
