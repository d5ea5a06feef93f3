"""A typed client for the service's HTTP API, with resumable uploads.

```python
with WibamClient("http://127.0.0.1:8000", token) as client:
    site = client.create_site(Site.load(folder / "site.json"))
    client.upload_recording(site.id, "north", folder / "recordings" / "north.mp4")
    job = client.wait(client.create_job(site.id).id)
    client.download_model(job.id, Path("weights.safetensors"))
```
"""

from wibam_core.client.client import WibamClient
from wibam_core.client.uploading import UploadProgress
from wibam_core.client.views import (
    ArtifactView,
    AuditView,
    ClipView,
    DeliveryView,
    FileView,
    FootageView,
    JobView,
    KeyView,
    ModelView,
    NewKeyView,
    NewWebhookView,
    PlannedView,
    ProblemView,
    SiteView,
    StageView,
    WebhookView,
)

__all__ = [
    "ArtifactView",
    "AuditView",
    "ClipView",
    "DeliveryView",
    "FileView",
    "FootageView",
    "JobView",
    "KeyView",
    "ModelView",
    "NewKeyView",
    "NewWebhookView",
    "PlannedView",
    "ProblemView",
    "SiteView",
    "StageView",
    "UploadProgress",
    "WebhookView",
    "WibamClient",
]
