"""From multi-view 2D boxes to 7DoF boxes, by direct fits and without a network."""
