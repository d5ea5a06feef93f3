"""The annotation set: its split in time and its statistics."""
