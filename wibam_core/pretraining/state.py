"""Averaged weights, and what an interrupted pre-training goes on from."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch
from torch import nn

Network = TypeVar("Network", bound=nn.Module)


class AveragedWeights(Generic[Network]):
    """An exponential moving average of a network's parameters and statistics."""

    def __init__(self, network: Network, decay: float) -> None:
        self.network = copy.deepcopy(network).eval()
        self._decay = decay
        self._updates = 0

    def state(self) -> dict[str, Any]:
        """All of it, for `restore`."""
        return {"network": self.network.state_dict(), "updates": self._updates}

    def restore(self, state: dict[str, Any]) -> None:
        """Take up what `state` gave."""
        self.network.load_state_dict(state["network"])
        self._updates = state["updates"]

    def update(self, network: nn.Module) -> None:
        """Take in a network after a step."""
        self._updates += 1
        weight = 1 - min(self._decay, self._updates / (self._updates + 10))
        averaged, current = self.network.state_dict(), network.state_dict()
        for name, value in averaged.items():
            if value.dtype.is_floating_point:
                value.lerp_(current[name], weight)
            else:
                value.copy_(current[name])


@dataclass(frozen=True, eq=False)
class TrainingState(Generic[Network]):
    """All that changes while a network is trained; the batches follow from the number of the step."""

    network: Network
    averaged: AveragedWeights[Network]
    optimizer: torch.optim.Optimizer
    scaler: torch.amp.GradScaler

    def save(self, path: Path, step: int, recent: dict[str, float]) -> None:
        """Write it, whole or not at all: after ``step`` steps, with the ``recent`` losses."""
        temporary = path.with_name(path.name + ".tmp")
        state = {name: part.state_dict() for name, part in self._parts().items()}
        torch.save({**state, "averaged": self.averaged.state(), "step": step, "recent": recent}, temporary)
        temporary.replace(path)

    def restore(self, path: Path, device: torch.device) -> tuple[int, dict[str, float]]:
        """Go back to what `save` wrote; returns the step and the recent losses."""
        state = torch.load(path, map_location=device, weights_only=True)
        for name, part in self._parts().items():
            part.load_state_dict(state[name])
        self.averaged.restore(state["averaged"])
        return state["step"], state["recent"]

    def _parts(self) -> dict[str, Any]:
        return {"network": self.network, "optimizer": self.optimizer, "scaler": self.scaler}
