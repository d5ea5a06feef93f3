"""How threads of PyTorch wait for work, which its OpenMP reads from the environment when it loads."""

from __future__ import annotations

from collections.abc import Mapping

#: Threads keep their core busy for about 40 µs, longer than from one part of a network's pass to the next, instead of 6
#: ms: on a machine with other work, whoever they wait for may need that core.
_WAITING = {"GOMP_SPINCOUNT": "2000"}


def waiting(environment: Mapping[str, str]) -> dict[str, str]:
    """The variables that a process needs, with the values that the environment gives them, if it does."""
    return {name: environment.get(name, usual) for name, usual in _WAITING.items()}
