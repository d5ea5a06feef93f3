from __future__ import annotations

from pathlib import Path

import pytest

from wibam_core.adapters.settings import ServiceSettings, StageLimits, token_digest
from wibam_core.errors import InputError

ENVIRONMENT = {"WIBAM_DATA_DIR": "/data", "WIBAM_BROKER_URL": "redis://r", "WIBAM_TOKEN_SHA256": token_digest("t")}


def test_what_is_written_is_what_is_read() -> None:
    settings = ServiceSettings(
        Path("/data"), "postgresql://x", "redis://r", token_digest("t"), 5_000_000_000, 7200.0,
        limits=StageLimits(2_000_000_000, 1800.0),
    )  # fmt: skip
    assert ServiceSettings.from_environment(settings.to_environment()) == settings


def test_sqlite_in_the_data_folder_is_the_default() -> None:
    assert ServiceSettings.from_environment(ENVIRONMENT).database_url == "sqlite:////data/wibam.db"


@pytest.mark.parametrize("name", sorted(ENVIRONMENT))
def test_what_is_missing_is_named(name: str) -> None:
    with pytest.raises(InputError, match=name):
        ServiceSettings.from_environment({**ENVIRONMENT, name: ""})


@pytest.mark.parametrize(
    ("name", "value"),
    [("WIBAM_TOKEN_SHA256", "secret"), ("WIBAM_UPLOAD_QUOTA_GB", "much"), ("WIBAM_CORS_ORIGINS", "*"),
     ("WIBAM_STAGE_HOURS", "-1"),     ("WIBAM_STAGE_MEMORY_GB", "nan")],
)  # fmt: skip
def test_what_is_wrong_is_named(name: str, value: str) -> None:
    with pytest.raises(InputError, match=name):
        ServiceSettings.from_environment({**ENVIRONMENT, name: value})
