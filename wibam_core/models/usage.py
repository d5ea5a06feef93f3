"""What a file of weights says about how its network is to be used, beside what it is."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, get_args

from wibam_core.errors import InvalidWeights
from wibam_core.models.frames import INPUT_WIDTH_PX
from wibam_core.models.trunk import INPUT_MULTIPLE
from wibam_core.placing import Decode

#: How the small network's boxes can be placed; first what a file means that does not say.
SMALL_DECODES: tuple[Decode, ...] = ("plane", "depth", "fused", "ground", "fitted", "refined")
#: The same of CenterTrack's DLA-34, which states no uncertainties to fuse by.
DLA34_DECODES: tuple[Decode, ...] = ("depth", "plane")

#: How a file says how wide the images are that its small network sees, and what can be said.
_INPUT_WIDTH = "input_width_px"
INPUT_WIDTHS_PX = range(320, 1920 + 1)


@dataclass(frozen=True)
class Usage:
    """How boxes and standard deviations come out as they were trained and measured.

    Attributes:
        decode: how boxes are placed.
        sd_factors: kind of number -> what its standard deviations are to be multiplied with; 1 for what is not named.
    """

    decode: Decode
    sd_factors: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))

    def metadata(self) -> dict[str, str]:
        """As a file says it: ``decode``, and ``sd_factors`` as JSON."""
        return {"decode": self.decode, "sd_factors": json.dumps(dict(self.sd_factors), allow_nan=False)}

    @classmethod
    def of(cls, source: str, metadata: Mapping[str, str], decodes: Sequence[Decode]) -> Usage:
        """As a file says it; what it does not say is ``decodes[0]`` and factors of 1.

        Args:
            source: name of the file.
            metadata: all that it says about itself.
            decodes: how its network's boxes can be placed.

        Raises:
            InvalidWeights: it says what cannot be.
        """
        said = metadata.get("decode", decodes[0])
        decode = next((known for known in decodes if known == said), None)
        if decode is None:
            raise InvalidWeights(f"{source}: decode is {said!r}, not one of {', '.join(decodes)}", field="decode")
        return cls(decode, _factors(source, metadata.get("sd_factors", "{}")))


def read_decode(curves: Mapping[str, Any]) -> Decode:
    """How a finetune stage's ``curves.json`` says that boxes are to be placed; old ones by the plane."""
    decode: Decode = curves.get("decode", "plane")
    if decode not in get_args(Decode):
        raise ValueError(f"no decoding is called {decode!r}")
    return decode


def input_width_metadata(input_width_px: int) -> dict[str, str]:
    """As a file says how wide the images are that its small network sees."""
    return {_INPUT_WIDTH: str(input_width_px)}


def read_input_width(source: str, metadata: Mapping[str, str]) -> int:
    """How wide the images are that a file's small network sees, px; `INPUT_WIDTH_PX` where it does not say.

    Raises:
        InvalidWeights: it says what cannot be.
    """
    said = metadata.get(_INPUT_WIDTH, str(INPUT_WIDTH_PX))
    width = int(said) if re.fullmatch("[0-9]{1,5}", said) else 0
    if width not in INPUT_WIDTHS_PX or width % INPUT_MULTIPLE:
        raise InvalidWeights(
            f"{source}: {_INPUT_WIDTH} is {said!r}, not a multiple of {INPUT_MULTIPLE} from {INPUT_WIDTHS_PX[0]} to "
            f"{INPUT_WIDTHS_PX[-1]}",
            field=_INPUT_WIDTH,
        )
    return width


def _factors(source: str, text: str) -> Mapping[str, float]:
    try:
        factors = json.loads(text)
        well = all(math.isfinite(value) and value > 0 for value in factors.values())
    except (ValueError, TypeError, AttributeError, OverflowError):
        well = False
    if not well:
        raise InvalidWeights(
            f"{source}: sd_factors is {text!r}, not a JSON object of positive numbers", field="sd_factors"
        )
    return MappingProxyType({str(name): float(value) for name, value in factors.items()})
