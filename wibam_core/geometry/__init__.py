"""Rigid transforms, cameras, the ground, boxes, pixels, overlaps, reprojection, and the steps of fits to them."""
