"""The error tree: every error a person may meet has a stable code, a sentence and a hint.

The web edge, the worker and the command line each map these once; nothing below them prints or
exits. Subclasses fix ``code``; the sentence says what happened and the hint what to do about it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar


class WibamError(Exception):
    """Base of all errors raised on purpose.

    Args:
        message: one sentence for a person: what is wrong, with the names and numbers in question.
        hint: what the person can do about it.
        details: machine-readable facts (JSON types only), for programs that react to the error.
    """

    code: ClassVar[str] = "internal"
    default_hint: ClassVar[str] = ""

    def __init__(self, message: str, *, hint: str | None = None, **details: Any) -> None:
        super().__init__(message)
        self.message = message
        self.hint = self.default_hint if hint is None else hint
        self.details: dict[str, Any] = details

    def to_dict(self) -> dict[str, Any]:
        """The error as JSON types: ``{"code", "message", "hint", "details"}``."""
        return {"code": self.code, "message": self.message, "hint": self.hint, "details": self.details}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> WibamError:
        """Rebuild an error that crossed a process or network boundary; unknown codes stay readable."""
        cls = _by_code().get(str(data.get("code")), WibamError)
        error = cls.__new__(cls)
        WibamError.__init__(
            error, str(data.get("message", "")), hint=data.get("hint"), **dict(data.get("details") or {})
        )
        if cls is WibamError and data.get("code"):
            error.code = str(data["code"])  # type: ignore[misc]  # an instance keeps a code this version does not know
        return error


def _by_code() -> dict[str, type[WibamError]]:
    found: dict[str, type[WibamError]] = {}
    pending = [WibamError]
    while pending:
        cls = pending.pop()
        found[cls.code] = cls
        pending.extend(cls.__subclasses__())
    return found


# --- what a user gave us -----------------------------------------------------------------------
class InputError(WibamError):
    """The user's input cannot be used as it is."""

    code = "invalid_input"


class UnknownOption(InputError):
    code = "unknown_option"
    default_hint = "Look up the options of this stage with `wibam run --show-config`."


class InvalidOption(UnknownOption):
    """An option that exists, with a value that it does not take."""

    code = "invalid_option"


class SiteFileError(InputError):
    code = "invalid_site"


class MissingCamera(InputError):
    code = "missing_camera"
    default_hint = "Upload a recording for every camera the site names, or remove the camera from the site."


class UnreadableVideo(InputError):
    code = "unreadable_video"
    default_hint = "Check that the file plays; re-encode it as H.264 in an MP4 file if it does."


class NoOverlap(InputError):
    code = "no_overlap"
    default_hint = "At least two recordings must show the same moments; check the clocks and the files."


class CalibrationError(InputError):
    code = "calibration_unsolvable"
    default_hint = "Give at least 6 well-spread correspondences per camera, in metres and in pixels of the recording."


class UnknownClock(InputError):
    """No witness says how a camera's clock runs against the others'."""

    code = "unknown_clock"


class NoSignalChange(InputError):
    code = "no_signal_change"
    default_hint = (
        "Draw the region tightly around the lamps, record at least one full signal cycle, "
        "or set sync.method to 'none' if the cameras share a clock."
    )


class NoVehicles(InputError):
    code = "no_vehicles"
    default_hint = "Check that traffic passes in view, and that the detector suits the footage."


class NoMultiViewVehicles(InputError):
    code = "no_multiview_vehicles"
    default_hint = "Check the calibration and the synchronisation: boxes of one vehicle must meet on the ground."


class TooFewInstants(InputError):
    code = "too_few_instants"
    default_hint = "Record for longer, or raise the sampling rate."


class InvalidWeights(InputError):
    code = "invalid_weights"
    default_hint = "Give a safetensors file made for this network."


class InvalidLabels(InputError):
    code = "invalid_labels"


# --- what went wrong while working -------------------------------------------------------------
class StageError(WibamError):
    """A stage of the pipeline failed."""

    code = "stage_failed"


class NonFiniteLoss(StageError):
    code = "non_finite_loss"
    default_hint = "Lower finetune.learning_rate, or look at the instants named in the details."


class StageCrashed(StageError):
    code = "stage_crashed"
    default_hint = "The job's log has the last lines of the stage; restart the job to try again."


class StageOutOfMemory(StageError):
    code = "stage_out_of_memory"
    default_hint = "Lower finetune.batch_size or frames.width_px, or give the worker more memory."


class StageTimedOut(StageError):
    code = "stage_timed_out"
    default_hint = "Raise the worker's stage time limit, or use a shorter recording."


class DiskFull(StageError):
    code = "disk_full"
    default_hint = "Free space in the data folder, then restart the job: finished stages are kept."


# --- the service -------------------------------------------------------------------------------
class NotFound(WibamError):
    code = "not_found"


class Conflict(WibamError):
    """The request contradicts the state of the thing it names."""

    code = "conflict"


class ChangedMeanwhile(Conflict):
    """What is to be replaced is no longer what the request was made of."""

    code = "changed_meanwhile"
    default_hint = "Read it again, put your changes into what is there now, and send that."


class Unauthorised(WibamError):
    code = "unauthorised"
    default_hint = "Send the API token as 'Authorization: Bearer TOKEN'; `wibam serve` prints it."


class TooCostly(InputError):
    """The work would take longer than whoever runs the service allows."""

    code = "too_costly"
    default_hint = (
        "Lower finetune.steps or frames.rate_hz, or use shorter recordings; whoever runs the service can raise "
        "WIBAM_JOB_HOURS."
    )


class Forbidden(WibamError):
    """Who asks is known, and may not do this."""

    code = "forbidden"


class QuotaExceeded(WibamError):
    code = "quota_exceeded"


class TooLarge(WibamError):
    code = "too_large"


class Locked(WibamError):
    """Somebody else is writing to this very thing right now."""

    code = "locked"
    default_hint = "Another request is still writing; try again in a moment."


class UploadExpired(WibamError):
    code = "upload_expired"
    default_hint = "Start a new upload."


class UnknownChecksum(InputError):
    """A checksum that is none, or of an algorithm that we do not know: tus has a status of its own for it."""

    code = "unknown_checksum"
    default_hint = "Upload-Checksum is an algorithm and base64, see https://tus.io; OPTIONS lists the algorithms."


class ChecksumMismatch(WibamError):
    code = "checksum_mismatch"
    default_hint = "The bytes were damaged on their way and were not kept; send them again."


class ServiceUnavailable(WibamError):
    code = "service_unavailable"
    default_hint = "Is the service running? Start it with `wibam serve`."


class MissingSumo(InputError):
    code = "missing_sumo"
    default_hint = "Install it with: pip install 'wibam[sumo]'"


class SumoFailed(StageError):
    code = "sumo_failed"
    default_hint = "Use traffic 'own', or another seed; the details have SUMO's last words."
