"""Bodies of requests as the OpenAPI document shows them. Each is sent in a test, with ids that are there."""

from __future__ import annotations

from typing import Any, Final

#: In examples these stand for ids of one's own.
SITE_ID, JOB_ID, FILE_ID = "site_3f0c9a1be2d44c70", "job_5e4d3c2b1a098765", "file_9b8a7c6d5e4f3a2b"

_CAMERA: Final = {
    "id": "north",
    "width_px": 1920,
    "height_px": 1080,
    "calibration": {
        "kind": "homography",
        "correspondences": [
            {"pixel": [310, 720], "world": [-12.0, 4.5, 0.0]},
            {"pixel": [1580, 690], "world": [11.5, 5.0, 0.0]},
            {"pixel": [1240, 410], "world": [9.0, 31.0, 0.0]},
            {"pixel": [620, 420], "world": [-8.5, 30.0, 0.0]},
        ],
    },
    "signals": [{"id": "left", "region": [900, 120, 18, 44]}],
}
#: By name of the schema.
EXAMPLES: Final[dict[str, Any]] = {
    "Site": {"name": "Main Street", "cameras": [_CAMERA]},
    "SiteCamera": _CAMERA,
    "JobIn": {"name": "Monday, second try", "tags": ["rain"], "options": {"finetune": {"steps": 200}}},
    "JobChangeIn": {"name": "Monday, in the rain", "tags": ["rain", "dusk"]},
    "RestartIn": {"from_stage": "track", "options": None},
    "ShareLinkIn": {"lifetime_h": 24},
    "ReviewIn": {"verdict": "confirmed", "note": "the cyclist had to brake"},
    "KeyIn": {"name": "camera van", "scopes": ["read", "upload"], "lifetime_days": 30},
    "ModelIn": {"job_id": JOB_ID, "name": "first"},
    "ModelChangeIn": {"state": "promoted"},
    "RunIn": {"files": [FILE_ID], "name": "July", "tags": ["july"], "options": {"track": {"rate_hz": 5}}},
    "FootageChangeIn": {"started_at": "2026-07-01T08:00:00+02:00"},
    "WebhookIn": {"url": "https://example.org/wibam", "site_id": SITE_ID, "events": ["job.failed"]},
    "WebhookChangeIn": {"active": False},
}
