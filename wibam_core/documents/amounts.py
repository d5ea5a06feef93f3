"""How good networks are by how much footage they learned from, over the jobs of a site."""

from __future__ import annotations

from typing import Literal

from wibam_core.documents.base import Document


class BeforeAfter(Document):
    """A figure of the network before and after fine-tuning; null where it is not known."""

    baseline: float | None
    finetuned: float | None


class JobAmount(Document):
    """What a job learned from, and how good its network is.

    Only jobs with the same test part and the same labels can be compared.
    """

    job_id: str
    name: str
    train_s: float
    """Length of the training part."""
    train_vehicles: int
    """Vehicles linked over time in it."""
    test_from_s: float
    test_to_s: float
    labels: Literal["hand", "none"]
    labelled_instants: int
    """In the test part."""
    bev_iou_misses_zero: BeforeAfter
    """IoU of the ground rectangles, every vehicle that was missed counted as 0."""
    recall: BeforeAfter
    other_views: BeforeAfter
    """IoU of reprojected boxes with the 2D boxes of the views that they were not made in; needs no labels."""
