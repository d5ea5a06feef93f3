"""Which 2D boxes of different cameras, and of different moments, show the same vehicle."""
