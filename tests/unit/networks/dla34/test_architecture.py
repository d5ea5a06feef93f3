"""DLA-34 against the published network's names, shapes and outputs; deformable convolution against an oracle."""

from __future__ import annotations

import json
import zlib
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.nn import functional

from wibam_core.networks.dla34.architecture import DLA34
from wibam_core.networks.dla34.deformable import DeformableConv2d, deformable_conv2d


def oracle(x: np.ndarray, offset: np.ndarray, mask: np.ndarray, weight: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """One pixel, tap and channel at a time."""
    channels, height, width = x.shape

    def at(c: int, row: int, column: int) -> float:
        return float(x[c, row, column]) if 0 <= row < height and 0 <= column < width else 0.0

    out = np.tile(bias[:, None, None], (1, height, width)).astype(float)
    for i, j, tap, c in np.ndindex(height, width, 9, channels):
        y = i + tap // 3 - 1 + offset[2 * tap, i, j]
        z = j + tap % 3 - 1 + offset[2 * tap + 1, i, j]
        r, s = int(np.floor(y)), int(np.floor(z))
        dy, dz = y - r, z - s
        value = (
            (1 - dy) * (1 - dz) * at(c, r, s)
            + (1 - dy) * dz * at(c, r, s + 1)
            + dy * (1 - dz) * at(c, r + 1, s)
            + dy * dz * at(c, r + 1, s + 1)
        )
        out[:, i, j] += weight[:, c, tap // 3, tap % 3] * mask[tap, i, j] * value
    return out


def test_deformable_convolution_equals_the_oracle() -> None:
    rng = np.random.default_rng(0)
    x, offset, mask = rng.normal(size=(2, 5, 6)), 2 * rng.normal(size=(18, 5, 6)), rng.uniform(size=(9, 5, 6))
    weight, bias = rng.normal(size=(3, 2, 3, 3)), rng.normal(size=3)
    found = deformable_conv2d(
        *(torch.tensor(v)[None] for v in (x, offset, mask)), torch.tensor(weight), torch.tensor(bias)
    )
    np.testing.assert_allclose(found[0].numpy(), oracle(x, offset, mask, weight, bias), atol=1e-9)


def test_without_offsets_it_is_a_plain_convolution() -> None:
    torch.manual_seed(0)
    layer = DeformableConv2d(4, 5).double()
    x = torch.randn(2, 4, 7, 9, dtype=torch.float64)
    expected = functional.conv2d(x, layer.weight, padding=1) * 0.5 + layer.bias[:, None, None]
    torch.testing.assert_close(layer(x), expected)


def test_deformable_convolution_is_differentiable() -> None:
    torch.manual_seed(0)
    shapes = [(1, 2, 4, 5), (1, 18, 4, 5), (1, 9, 4, 5), (3, 2, 3, 3), (3,)]
    values = [torch.randn(s, dtype=torch.float64, requires_grad=True) for s in shapes]
    assert torch.autograd.gradcheck(deformable_conv2d, values)


def test_names_and_shapes_are_the_published_ones(assets: Path) -> None:
    expected = json.loads((assets / "reference" / "centertrack_dla34_ddd_state_dict.json").read_text())
    assert {name: list(value.shape) for name, value in DLA34().state_dict().items()} == expected


def test_outputs_are_the_published_ones(assets: Path) -> None:
    network = DLA34().eval()
    state = network.state_dict()
    for name, value in state.items():
        shape = tuple(value.shape)
        rng = np.random.default_rng(zlib.crc32(name.encode()))
        if name.endswith("num_batches_tracked"):
            continue
        if name.endswith("running_var"):
            filled = np.ones(shape)
        elif name.endswith("running_mean"):
            filled = np.zeros(shape)
        elif len(shape) == 1:
            filled = (1.0 if name.endswith("weight") else 0.0) + 0.1 * rng.standard_normal(shape)
        else:
            filled = rng.standard_normal(shape) * np.sqrt(2 / np.prod(shape[1:]))
        state[name] = torch.from_numpy(filled.astype(np.float32))
    network.load_state_dict(state)
    rng = np.random.default_rng(zlib.crc32(b"input"))
    images = torch.from_numpy(rng.standard_normal((1, 3, 128, 224)).astype(np.float32))
    with torch.no_grad():
        found = network(images)
        exact = network.double()(images.double())
    expected = np.load(assets / "reference" / "centertrack_dla34_ddd_outputs.npz")
    assert set(found) == set(exact) == set(expected.files)
    for name in found:
        # These weights amplify rounding: float32 moves by up to 2e-3 with the processor or the memory layout alone, so
        # what is exact on every machine is held to the published values, and float32 to its rounding.
        assert found[name].dtype == torch.float32
        assert np.abs(found[name].numpy() - expected[name]).max() < 4e-3, name
        error = np.abs(exact[name].numpy() - expected[name])
        assert np.quantile(error, 0.999) < 1e-3, name
        assert error.max() < 2e-3, name


@pytest.mark.parametrize(("height", "width"), [(64, 96), (32, 160)])
def test_any_size_of_multiples_of_32(height: int, width: int) -> None:
    with torch.no_grad():
        outputs = DLA34({"hm": 4}).eval()(torch.zeros(1, 3, height, width))
    assert outputs["hm"].shape == (1, 4, height // 4, width // 4)
