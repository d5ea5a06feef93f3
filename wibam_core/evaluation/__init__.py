"""How good a detector is at a site: matching, metrics, significance, and consistency between views."""
