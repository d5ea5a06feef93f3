"""Where networks are trained, and in which precision."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from wibam_core.config import DeviceOption as DeviceOption
from wibam_core.errors import InvalidOption

#: As the option ``finetune.device``.


def choose_device(option: DeviceOption, name: str = "finetune.device") -> torch.device:
    """The device that the option ``name`` asks for; "auto" is CUDA where there is one.

    Raises:
        InvalidOption: "cuda" on a machine without.
    """
    there = torch.cuda.is_available()
    if option == "cuda" and not there:
        raise InvalidOption(
            f"option {name} is 'cuda', but PyTorch sees no CUDA device here",
            hint="Set it to 'auto' or 'cpu', or install a PyTorch built for CUDA on a machine with an NVIDIA GPU.",
            option=name,
        )
    return torch.device("cuda" if there and option != "cpu" else "cpu")


def choose_device_to_detect(trained_on: DeviceOption) -> torch.device:
    """The device for a network that was trained with this option: training's own, or the CPU where CUDA has gone."""
    return choose_device("auto" if trained_on == "cuda" else trained_on)


@dataclass(frozen=True)
class Precision:
    """In what networks compute; losses and geometry are float32 and float64 whatever this is.

    Attributes:
        device: cpu or cuda.
        dtype: of the convolutions; None for float32 throughout.
    """

    device: torch.device
    dtype: torch.dtype | None

    @classmethod
    def of(cls, device: torch.device) -> Precision:
        """The fastest that the device has: bfloat16; float16 on GPUs without; float32 on processors without."""
        if device.type == "cuda":
            return cls(device, torch.bfloat16 if torch.cuda.is_bf16_supported(False) else torch.float16)
        return cls(device, torch.bfloat16 if has_bfloat16() else None)

    def autocast(self) -> torch.autocast:
        """The context in which a network is to run."""
        return torch.autocast(self.device.type, dtype=self.dtype or torch.bfloat16, enabled=self.dtype is not None)

    def scaler(self) -> torch.amp.GradScaler:
        """Keeps gradients within float16's range; does nothing with other types."""
        return torch.amp.GradScaler(self.device.type, enabled=self.dtype is torch.float16)


def has_bfloat16() -> bool:
    """Whether the processor multiplies in bfloat16; without, mixed precision is slower than float32."""
    return bool(torch.cpu.get_capabilities().get("avx512_bf16", False))
