"""Images as planes of float32."""

import numpy as np
import pytest

from wibam_core.detection.planes import shares_of


@pytest.mark.parametrize("highest", [1.0, 255.0])
def test_convention_planes_are_shares_of_the_brightest_value(highest: float) -> None:
    planes = np.random.default_rng(1).integers(0, 256, (3, 5, 7), dtype=np.uint8)
    shares = shares_of(list(planes), highest)
    assert shares.dtype == np.float32 and shares.flags.c_contiguous
    np.testing.assert_allclose(shares, planes / 255.0 * highest, rtol=1e-7)
