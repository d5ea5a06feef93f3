"""Serve on a socket that was bound by whoever starts us: ``python -m api --fd N``. Settings are in the environment."""

from __future__ import annotations

import argparse
import socket

import uvicorn

from api.main import create


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m api")
    parser.add_argument("--fd", type=int, required=True, help="file descriptor of a listening socket")
    arguments = parser.parse_args()
    config = uvicorn.Config(create, factory=True, log_level="warning", timeout_graceful_shutdown=3)
    uvicorn.Server(config).run(sockets=[socket.socket(fileno=arguments.fd)])


if __name__ == "__main__":
    main()
