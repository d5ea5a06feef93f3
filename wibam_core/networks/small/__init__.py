"""The small centre-point network that ships with the project."""
