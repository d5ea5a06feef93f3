"""What every stage is given. A stage is a module with ``run(context, config) -> summary``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wibam_core.progress import Progress
from wibam_core.site import Site

#: Figures of a stage for a person and for the job's status: JSON types only.
Summary = dict[str, Any]


@dataclass(frozen=True)
class StageContext:
    """The surroundings of one run of one stage.

    Attributes:
        site: what the user said.
        recordings: camera id -> uploaded file.
        assets: other uploaded files: "labels", "detector", "network".
        upstream: name of each required stage -> its published output folder (read only).
        output: an empty folder; published as a whole once the stage returns.
        scratch: survives a killed attempt of this very stage (same hash): checkpoints to resume from.
        progress: call it a few times a second at most.
    """

    site: Site
    recordings: Mapping[str, Path]
    assets: Mapping[str, Path]
    upstream: Mapping[str, Path]
    output: Path
    scratch: Path
    progress: Progress
