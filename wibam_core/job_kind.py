"""What jobs there are."""

from __future__ import annotations

from enum import StrEnum


class JobKind(StrEnum):
    """What a job is for: to train a network on a site's recordings, or to run one that is there on new footage."""

    TRAINING = "training"
    RUN = "run"
