"""CenterTrack's monocular 3D detector with a DLA-34 backbone, by weights that a user brings."""
