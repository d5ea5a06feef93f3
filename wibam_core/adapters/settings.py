"""The service's settings. They are read from the environment here, at the edge, and nowhere else."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from ipaddress import IPv4Network, IPv6Network, ip_network
from pathlib import Path

from wibam_core.errors import InputError
from wibam_core.jobs.leases import LeasePolicy

_GB = 1_000_000_000


@dataclass(frozen=True)
class StageLimits:
    """What one stage may take.

    Attributes:
        memory_bytes: resident memory.
        seconds: wall time.
        nice: its scheduling priority.
        job_seconds: a job that is expected to take longer is refused once its recordings were looked at.
        times_expected: no stage may take so many times as long as is expected of it, but
        least_seconds: any may take so long: what was expected of little work says little.
    """

    memory_bytes: int
    seconds: float
    nice: int = 5
    job_seconds: float = 7 * 24 * 3600.0
    times_expected: float = 20.0
    least_seconds: float = 900.0

    def __post_init__(self) -> None:
        positive = (self.memory_bytes, self.seconds, self.job_seconds, self.times_expected, self.least_seconds)
        if min(positive) <= 0 or not 0 <= self.nice <= 19:
            raise ValueError("limits must be positive, nice in [0, 19]")


def _most_of_the_memory() -> int:
    return int(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") * 0.8)


@dataclass(frozen=True)
class ServiceSettings:
    """What api and worker need to know. Both must be given the same.

    Attributes:
        data_dir: the data folder (`DataFolder`).
        database_url: an SQLAlchemy URL.
        broker_url: of Redis, e.g. ``redis://redis:6379/0`` or ``redis+socket:///path/redis.sock``.
        token_sha256: SHA-256 (hex) of the API token; the token itself is not kept.
        upload_quota_bytes: all uploads together. upload_lifetime_s: unfinished ones are dropped without news.
        webhook_networks: webhooks may lead into these beside the public internet.
        cors_origins: pages of these origins, e.g. ``https://app.example``, may use the API from a browser.
    """

    data_dir: Path
    database_url: str
    broker_url: str
    token_sha256: str
    upload_quota_bytes: int = 500 * _GB
    upload_lifetime_s: float = 24 * 3600.0
    cors_origins: tuple[str, ...] = ()
    webhook_networks: tuple[IPv4Network | IPv6Network, ...] = ()
    leases: LeasePolicy = field(default_factory=LeasePolicy)
    limits: StageLimits = field(default_factory=lambda: StageLimits(_most_of_the_memory(), 6 * 3600.0))

    def __post_init__(self) -> None:
        if len(self.token_sha256) != 64 or set(self.token_sha256) - set("0123456789abcdef"):
            raise InputError(
                "WIBAM_TOKEN_SHA256 is not a SHA-256 in lower-case hexadecimal",
                hint='Make it with: printf %s "$TOKEN" | sha256sum',
            )

        for origin in self.cors_origins:
            if not re.fullmatch(r"https?://[^/\s*?#]+", origin):
                raise InputError(
                    f"WIBAM_CORS_ORIGINS: {origin!r} is no origin",
                    hint="Give scheme, host and port alone, several separated by commas: https://app.example.",
                )

    @classmethod
    def from_environment(cls, environment: Mapping[str, str]) -> ServiceSettings:
        """Raises:
        InputError: naming the first variable that is missing or wrong.
        """
        from wibam_core.adapters.database import sqlite_url  # SQLAlchemy takes a quarter of a second to load

        data_dir = Path(_required(environment, "WIBAM_DATA_DIR")).absolute()
        return cls(
            data_dir=data_dir,
            database_url=environment.get("WIBAM_DATABASE_URL") or sqlite_url(data_dir / "wibam.db"),
            broker_url=_required(environment, "WIBAM_BROKER_URL"),
            token_sha256=_required(environment, "WIBAM_TOKEN_SHA256"),
            upload_quota_bytes=int(_number(environment, "WIBAM_UPLOAD_QUOTA_GB", 500.0) * _GB),
            upload_lifetime_s=_number(environment, "WIBAM_UPLOAD_LIFETIME_H", 24.0) * 3600.0,
            cors_origins=tuple(filter(None, map(str.strip, environment.get("WIBAM_CORS_ORIGINS", "").split(",")))),
            webhook_networks=_networks(environment.get("WIBAM_WEBHOOK_NETWORKS", "")),
            limits=StageLimits(
                int(_number(environment, "WIBAM_STAGE_MEMORY_GB", _most_of_the_memory() / _GB) * _GB),
                _number(environment, "WIBAM_STAGE_HOURS", 6.0) * 3600.0,
                job_seconds=_number(environment, "WIBAM_JOB_HOURS", 168.0) * 3600.0,
                times_expected=_number(environment, "WIBAM_STAGE_TIMES_EXPECTED", 20.0),
            ),
        )

    def to_environment(self) -> dict[str, str]:
        """What `from_environment` reads."""
        return {
            "WIBAM_DATA_DIR": str(self.data_dir),
            "WIBAM_DATABASE_URL": self.database_url,
            "WIBAM_BROKER_URL": self.broker_url,
            "WIBAM_TOKEN_SHA256": self.token_sha256,
            "WIBAM_UPLOAD_QUOTA_GB": repr(self.upload_quota_bytes / _GB),
            "WIBAM_UPLOAD_LIFETIME_H": repr(self.upload_lifetime_s / 3600.0),
            "WIBAM_CORS_ORIGINS": ",".join(self.cors_origins),
            "WIBAM_WEBHOOK_NETWORKS": ",".join(map(str, self.webhook_networks)),
            "WIBAM_STAGE_MEMORY_GB": repr(self.limits.memory_bytes / _GB),
            "WIBAM_STAGE_HOURS": repr(self.limits.seconds / 3600.0),
            "WIBAM_STAGE_TIMES_EXPECTED": repr(self.limits.times_expected),
            "WIBAM_JOB_HOURS": repr(self.limits.job_seconds / 3600.0),
        }


def token_digest(token: str) -> str:
    """The SHA-256 (hex) by which the service knows a token. Tokens are long and random, so no salt is needed."""
    return hashlib.sha256(token.encode()).hexdigest()


def _networks(text: str) -> tuple[IPv4Network | IPv6Network, ...]:
    try:
        return tuple(ip_network(part) for part in filter(None, map(str.strip, text.split(","))))
    except ValueError as error:
        raise InputError(
            f"WIBAM_WEBHOOK_NETWORKS: {error}", hint="Give networks separated by commas: 10.0.0.0/8,fd00::/8."
        ) from None


def _required(environment: Mapping[str, str], name: str) -> str:
    value = environment.get(name, "")
    if not value:
        raise InputError(f"{name} is not set", hint="`wibam serve` sets it; deploy/service.env.example explains all.")
    return value


def _number(environment: Mapping[str, str], name: str, default: float) -> float:
    text = environment.get(name, "")
    try:
        value = float(text) if text else default
    except ValueError:
        raise InputError(f"{name} must be a number, not {text!r}") from None
    if not value > 0:
        raise InputError(f"{name} must be positive, not {text}")
    return value
