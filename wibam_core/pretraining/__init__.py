"""How the bundled networks were made: scripts, one a network, and what they share."""
