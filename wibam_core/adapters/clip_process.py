"""Render one clip: ``python -m wibam_core.adapters.clip_process REQUEST.json``, a `ClipRequest`.

Frames were decoded from an uploaded video, and are not to be trusted either: a worker starts this confined. It speaks
the JSON lines of `wibam_core.stages.execute`; what ``done`` carries is a `ClipFacts`.
"""

from __future__ import annotations

import errno
import sys
import traceback
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from wibam_core.artifacts.access import ArtifactReader
from wibam_core.documents.clips import ClipFacts, ClipSpec
from wibam_core.errors import DiskFull, StageCrashed, StageOutOfMemory, WibamError
from wibam_core.progress import Progress
from wibam_core.stages.execute import Reporter


class ClipRequest(BaseModel):
    """What to render. Paths are the service's own, never a user's.

    Attributes:
        outputs: published outputs by stage.
        spec: what the clip is to show.
        target: the file to write.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    outputs: dict[str, Path]
    spec: ClipSpec
    target: Path


def render(request: ClipRequest, progress: Progress) -> ClipFacts:
    """Render it in this process.

    Raises:
        WibamError: whatever went wrong, as the tree of errors says it.
    """
    from wibam_core.clips.render import ClipRenderer  # whoever only builds requests needs none of its libraries

    try:
        return ClipRenderer(ArtifactReader(request.outputs), request.spec).render(request.target, progress)
    except WibamError:
        raise
    except MemoryError as error:
        raise StageOutOfMemory("the clip needs more memory than there is", hint="Ask for a smaller one.") from error
    except Exception as error:
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise DiskFull("no space left for the clip") from error
        traceback.print_exc()
        raise StageCrashed(f"the clip could not be rendered: {type(error).__name__}: {error}") from error


def main(arguments: list[str]) -> int:
    """The program: see the module's docstring."""
    reporter = Reporter.on_standard_output()
    request = ClipRequest.model_validate_json(Path(arguments[0]).read_bytes())
    try:
        facts = render(request, reporter)
    except WibamError as error:
        reporter.emit("failed", error=error.to_dict())
        return 1
    reporter.emit("done", summary=facts.model_dump(mode="json"))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
