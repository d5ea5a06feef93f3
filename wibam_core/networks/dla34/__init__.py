"""CenterTrack's monocular 3D detector with a DLA-34 backbone, by weights that a user brings."""

from wibam_core.networks.dla34.network import DECODES, FAMILY_NAME, CenterTrack
from wibam_core.networks.family import Family

FAMILY = Family(
    name=FAMILY_NAME,
    decodes=DECODES,
    methods=tuple(CenterTrack.default_rates),
    load=CenterTrack.load,
    own_input="images as CenterTrack does, 800 px at the longer side",
    advice="CenterTrack's DLA-34 takes a second or more per frame on a CPU; a lower --rate helps.",
)
