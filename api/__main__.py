"""Serve: ``python -m api --host 0.0.0.0 --port 8000``, or ``--fd N`` on a socket that was bound by whoever starts us.

Settings are in the environment.
"""

from __future__ import annotations

import argparse
import logging
import socket
from typing import Any

import uvicorn

from api.main import create
from api.protocol import PatientProtocol
from api.telemetry import name_requests_in_logs

_LOG_FORMAT = "%(asctime)s %(levelname)s %(name)s [%(request_id)s] %(message)s"


def server_config(app: Any, **more: Any) -> uvicorn.Config:
    """How an application is served; ``more`` as uvicorn takes it."""
    ours = {"http": PatientProtocol, "log_level": "warning", "log_config": None, "timeout_graceful_shutdown": 3}
    return uvicorn.Config(app, **{**ours, **more})


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m api")
    parser.add_argument("--fd", type=int, help="file descriptor of a listening socket")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=8000)
    arguments = parser.parse_args()
    name_requests_in_logs()
    logging.basicConfig(format=_LOG_FORMAT, level=logging.WARNING)
    config = server_config(create, factory=True, host=arguments.host, port=arguments.port)
    given = [socket.socket(fileno=arguments.fd)] if arguments.fd is not None else None
    uvicorn.Server(config).run(sockets=given)


if __name__ == "__main__":
    main()
