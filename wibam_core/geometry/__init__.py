"""Rigid transforms, cameras, the ground, boxes, overlaps and reprojection."""
