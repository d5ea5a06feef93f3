"""What makes a result doubtful, though not so much that the work stops: the gentler sister of `wibam_core.errors`."""

from __future__ import annotations

from pydantic import Field, JsonValue

from wibam_core.documents.base import Document


class Caution(Document):
    """Something that a person should look at, as whoever notices it says it."""

    code: str
    """Stable, for programs."""
    message: str
    """One sentence: what is doubtful, with the names and numbers in question."""
    hint: str
    """What the person can do about it."""
    details: dict[str, JsonValue] = Field(default_factory=dict)
    """Facts for programs, such as "camera"."""

    def of_camera(self, camera_id: str) -> Caution:
        """The same, said of a camera."""
        details = {"camera": camera_id, **self.details}
        return self.model_copy(update={"message": f"Camera {camera_id}: {self.message}", "details": details})


class StageWarning(Caution):
    """A caution of a stage, as the job, the log, the terminal and the report show it."""

    stage: str
