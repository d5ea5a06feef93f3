"""The small centre-point network that ships with the project."""

from wibam_core.networks.family import Family
from wibam_core.networks.small.network import SmallMonocular
from wibam_core.networks.small.onnx_network import DECODES, FAMILY_NAME, OnnxNetwork

FAMILY = Family(
    name=FAMILY_NAME,
    decodes=DECODES,
    methods=tuple(SmallMonocular.default_rates),
    load=SmallMonocular.load,
    load_onnx=OnnxNetwork,
)
