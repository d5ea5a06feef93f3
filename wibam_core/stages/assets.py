"""Files that a site may bring beside its recordings, and which options use them."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from wibam_core.config import PipelineConfig
from wibam_core.errors import InputError


@dataclass(frozen=True)
class Asset:
    """One such file.

    Attributes:
        name: by which stages know it, and the purpose of its upload.
        files: what it is called in a site's folder; of several that are there the first counts.
        option: stage and name of the option that uses it where it is "custom"; None where it is used whenever it is
            there.
        hint: where one gets it from.
    """

    name: str
    files: tuple[str, ...]
    option: tuple[str, str] | None = None
    hint: str = ""

    def is_used(self, config: PipelineConfig) -> bool:
        """Whether these options use it, where it is there."""
        if self.option is None:
            return True
        stage, option = self.option
        return getattr(getattr(config, stage), option) == "custom"


_ALL = (
    Asset("labels", ("labels.parquet", "labels.json")),
    Asset(
        "detector",
        ("detector.onnx",),
        ("detect", "detector"),
        "Give the site a detector.onnx (YOLOX family, COCO classes), or leave the option out.",
    ),
    Asset(
        "network",
        ("network.safetensors",),
        ("finetune", "network"),
        "Give the site a network.safetensors, as `wibam weights convert` writes it, or leave the option out.",
    ),
    # those of a run; a site's folder holds none of them
    Asset("model", ()),
    Asset("usual", ()),
    Asset("track_errors", ()),
    Asset("open_tracks", ()),
)

#: By name.
ASSETS: Mapping[str, Asset] = MappingProxyType({asset.name: asset for asset in _ALL})


def require_assets(config: PipelineConfig, there: Container[str]) -> None:
    """Refuse options that ask for a file of the site's own which it has not.

    Args:
        config: all options.
        there: names of the assets that the site has.

    Raises:
        InputError: naming the first option that asks for one that is not there.
    """
    for asset in ASSETS.values():
        if asset.option is not None and asset.is_used(config) and asset.name not in there:
            raise InputError(
                f"option {'.'.join(asset.option)} is 'custom', but the site has no {asset.name}", hint=asset.hint
            )
