"""Decoders away from the exact targets: gradients, horizons, uncertainty. `test_targets.py` holds the round trip."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.builders import look_at
from wibam_core.geometry.torch_ops import CameraTensors, wrap_angle
from wibam_core.models.peaks import cell_centres_px, find_peaks
from wibam_core.networks.small.architecture import MEAN_SIZES_M, SmallOutputs
from wibam_core.networks.small.decode import (
    TAUGHT_CELLS,
    PeakValues,
    boxes3d,
    gather_around,
    standard_deviations,
)
from wibam_core.networks.small.export import channels
from wibam_core.placing import Decode

SIZES = torch.tensor(MEAN_SIZES_M)


def cameras() -> CameraTensors:
    places = [(20.0, 0.0, 7.0), (0.0, -25.0, 9.0)]
    return CameraTensors.from_cameras(
        [look_at(at, focal_px=400.0, width_px=512, height_px=288) for at in places], torch.float64
    )


def values(n: int = 6, seed: int = 0) -> PeakValues:
    rng = np.random.default_rng(seed)

    def tensor(*shape: int) -> torch.Tensor:
        return torch.tensor(rng.normal(0, 0.3, shape))

    return PeakValues(
        torch.tensor(rng.integers(0, 2, n)),
        torch.tensor(np.column_stack([rng.integers(20, 100, n), rng.integers(30, 70, n)])),
        torch.tensor(rng.integers(0, 4, n)),
        tensor(n, 4),
        tensor(n, 2),
        tensor(n) + 3.0,
        tensor(n, 3),
        tensor(n, 2),
        tensor(n, 2) + torch.tensor([0.0, 2.0]),
        tensor(n, 5) - 2.0,
    )


@pytest.mark.parametrize("decode", ["plane", "depth", "ground"])
def test_decoding_is_differentiable(decode: Decode) -> None:
    found = values()

    names = ("centre3d", "depth", "size", "yaw", "footprint")

    def decoded(*leaves: torch.Tensor) -> torch.Tensor:
        return boxes3d(replace(found, **dict(zip(names, leaves, strict=True))), cameras(), SIZES, decode)

    leaves = [getattr(found, name).clone().requires_grad_() for name in names]
    assert torch.autograd.gradcheck(decoded, leaves, atol=1e-5)


@pytest.mark.parametrize("decode", ["plane", "fused", "ground", "fitted", "refined"])
def test_boxes_stand_on_the_ground(decode: Decode) -> None:
    boxes = boxes3d(values(), cameras(), SIZES, decode)
    torch.testing.assert_close(boxes[:, 2], boxes[:, 5] / 2)


def test_by_its_footprint_a_vehicle_is_placed_whatever_its_height() -> None:
    found = values()
    taller = replace(found, size=found.size + torch.tensor([0.0, 0.0, 0.2]))
    for decode, moved_m in (("ground", 0.0), ("plane", 0.1)):
        boxes, higher = (boxes3d(each, cameras(), SIZES, decode) for each in (found, taller))
        moves = torch.linalg.norm((higher - boxes)[:, :2], dim=1)
        assert bool((moves <= 1e-9).all() if moved_m == 0 else (moves > moved_m).all()), decode


def test_boxes_are_finite_and_plausible_whatever_the_network_says() -> None:
    wild = values()
    wild = PeakValues(
        wild.image,
        wild.cells * 0,  # the sky
        wild.classes,
        wild.box2d * 100,
        wild.centre3d * 100,
        wild.depth * 100,
        wild.size * 100,
        wild.yaw * 0,
        wild.footprint * 100,
        wild.log_scale * 100,
    )
    for decode in ("plane", "depth", "fused", "ground", "fitted", "refined"):
        boxes = boxes3d(wild, cameras(), SIZES, decode)
        assert torch.isfinite(boxes).all()
        assert (boxes[:, 3:6] > 0).all()
        assert torch.isfinite(standard_deviations(wild, boxes, cameras(), decode)).all()


@pytest.mark.parametrize(
    ("decode", "head", "log_scale"),
    [("plane", "centre3d", [-3.0, 0.0, -3.0, -3.0, 0.0]), ("ground", "footprint", [0.0, 0.0, -3.0, -3.0, -3.0])],
)
def test_the_positions_uncertainty_is_that_of_what_is_moved_over_the_ground(
    decode: Decode, head: str, log_scale: list[float]
) -> None:
    found = values(n=1, seed=3)
    fields = {name: getattr(found, name) for name in found.__dataclass_fields__} | {
        "log_scale": torch.tensor([log_scale]).double()
    }
    found = PeakValues(**fields)
    boxes = boxes3d(found, cameras(), SIZES, decode)
    sd = standard_deviations(found, boxes, cameras(), decode)[0]
    scale = float(np.exp(-3.0) * np.sqrt(2))
    rng = np.random.default_rng(0)
    moved = []
    for offset in rng.normal(0, scale, (4000, 2)):
        shifted = PeakValues(**(fields | {head: fields[head] + torch.tensor(offset)}))
        moved.append(boxes3d(shifted, cameras(), SIZES, decode)[0, :2].numpy())
    np.testing.assert_allclose(sd[:2].numpy(), np.std(moved, axis=0), rtol=0.1)
    np.testing.assert_allclose(sd[3:6].numpy(), boxes[0, 3:6].numpy() * scale, rtol=1e-6)
    assert float(sd[6]) == pytest.approx(scale)


def test_under_depth_decoding_the_depths_uncertainty_lies_along_the_ray() -> None:
    found = values(n=1, seed=3)
    quiet = torch.tensor([[-9.0, -2.0, -3.0, -3.0, 0.0]], dtype=torch.float64)
    found = replace(found, log_scale=quiet)
    boxes = boxes3d(found, cameras(), SIZES, "depth")
    sd = standard_deviations(found, boxes, cameras(), "depth")[0]
    offset = boxes[0, :3] - cameras()[found.image].centre_m[0]
    share = float(np.exp(-2.0) * np.sqrt(2))
    np.testing.assert_allclose(sd[:3].numpy(), offset.abs().numpy() * share, rtol=0.02)
    assert float(standard_deviations(found, boxes, cameras(), "plane")[0, :2].max()) < 0.2 * float(sd[:2].max())


def test_fused_boxes_lie_where_the_more_certain_of_plane_and_depth_puts_them() -> None:
    found = values()
    for certain, other, decode in ((-9.0, 0.0, "plane"), (0.0, -9.0, "depth")):
        log_scale = torch.tensor([[certain, other, certain, -3.0, 0.0]], dtype=torch.float64).expand(6, 5)
        sure = replace(found, log_scale=log_scale)
        fused, alone = (boxes3d(sure, cameras(), SIZES, how) for how in ("fused", decode))
        torch.testing.assert_close(fused[:, :2], alone[:, :2], atol=0.01, rtol=0)
        torch.testing.assert_close(fused[:, 2], fused[:, 5] / 2)


def test_fusion_is_better_than_either_and_says_how_good_it_is() -> None:
    n = 4000
    one = values(n=1, seed=3)
    scales = torch.tensor([[0.35, 0.012, 0.02, 0.05, 0.35]], dtype=torch.float64)
    rng = np.random.default_rng(1)

    def noise(size: tuple[int, ...], column: int) -> torch.Tensor:
        return torch.tensor(rng.laplace(0, float(scales[0, column]), size))

    truth = boxes3d(one, cameras(), SIZES, "plane")[0]
    seen_by = cameras()[one.image]
    forward = seen_by.rotation[0, 2]
    depth = torch.log((truth[:3] - seen_by.centre_m[0]) @ forward)[None]  # the cameras have the reference focal length
    repeated = {name: getattr(one, name).repeat_interleave(n, dim=0) for name in one.__dataclass_fields__}
    noisy = PeakValues(
        **repeated
        | {
            "centre3d": repeated["centre3d"] + noise((n, 2), 0),
            "depth": depth.expand(n) + noise((n,), 1),
            "size": repeated["size"] + noise((n, 1), 2),
            "log_scale": torch.log(scales).expand(n, 5),
        }
    )
    error = {}
    for how in ("plane", "depth", "fused"):
        boxes = boxes3d(noisy, cameras(), SIZES, how)
        error[how] = float((boxes[:, :2] - truth[:2]).square().sum(dim=1).mean().sqrt())
    assert error["fused"] < 0.93 * min(error["plane"], error["depth"])
    fused = boxes3d(noisy, cameras(), SIZES, "fused")
    stated = standard_deviations(noisy, fused, cameras(), "fused")[:, :2].square().sum(dim=1).mean().sqrt()
    assert error["fused"] == pytest.approx(float(stated), rel=0.15)


def test_near_the_horizon_the_plane_tells_nothing_and_says_so() -> None:
    low = CameraTensors.from_cameras(
        [look_at((20.0, 0.0, 1.6), focal_px=400.0, width_px=512, height_px=288)] * 2, torch.float64
    )
    found = values(n=1, seed=3)
    away = 60.0
    horizon = replace(
        found,
        cells=torch.tensor([[64, 20]]),
        centre3d=torch.zeros_like(found.centre3d),
        depth=torch.log(torch.tensor([away], dtype=torch.float64)),
        log_scale=torch.full((1, 5), -3.0, dtype=torch.float64),
    )
    plane, fused, depth = (boxes3d(horizon, low, SIZES, how) for how in ("plane", "fused", "depth"))
    torch.testing.assert_close(fused[:, :2], depth[:, :2])
    sd = standard_deviations(horizon, plane, low, "plane")[0, :2]
    assert float(torch.linalg.norm(sd)) > 0.9 * float(torch.linalg.norm(plane[0, :2] - low.centre_m[0, :2]))


def test_convention_cells_are_centred_in_their_four_pixels() -> None:
    np.testing.assert_allclose(cell_centres_px(torch.tensor([[0, 0], [10, 3]])).numpy(), [[1.5, 1.5], [41.5, 13.5]])


def test_angles_wrap_to_the_half_open_circle() -> None:
    angles = torch.tensor([0.0, torch.pi, -torch.pi, 4.0, -4.0, 20.0], dtype=torch.float64)
    wrapped = wrap_angle(angles)
    assert (wrapped > -torch.pi).all()
    assert (wrapped <= torch.pi).all()
    torch.testing.assert_close(torch.sin(wrapped), torch.sin(angles))
    torch.testing.assert_close(torch.cos(wrapped), torch.cos(angles))


def test_peaks_are_local_maxima_best_first() -> None:
    heat = torch.full((2, 4, 12, 16), -6.0)
    heat[0, 1, 5, 7] = 3.0
    heat[0, 2, 5, 8] = 2.0  # beside a better peak of another class
    heat[0, 0, 9, 2] = 1.0
    heat[1, 3, 0, 0] = 0.0
    peaks = find_peaks(heat, 0.3)
    assert peaks.image.tolist() == [0, 0, 1]
    assert peaks.cells.tolist() == [[7, 5], [2, 9], [0, 0]]
    assert peaks.classes.tolist() == [1, 0, 3]
    assert peaks.scores.tolist() == pytest.approx([0.9526, 0.7311, 0.5], abs=1e-3)
    assert len(find_peaks(heat, 0.3, top_k=1).image) == 2
    assert len(find_peaks(heat, 0.99).image) == 0


@pytest.mark.parametrize(("cell", "told_by"), [((4, 3), [0, 1, 2, 3, 4]), ((0, 5), [0, 1, 4]), ((7, 0), [0, 2, 3])])
def test_all_cells_that_know_a_vehicle_have_a_say(cell: tuple[int, int], told_by: list[int]) -> None:
    """Each cell tells the same vehicle by its own offset, but for an error of its own."""
    rng = np.random.default_rng(5)
    maps = {name: torch.zeros(2, count, 6, 8) for name, count in channels(len(SIZES)).items()}
    truth = {name: rng.normal(size=len(maps[name][0])) for name in ("box2d", "centre3d", "footprint", "size", "yaw")}
    errors = rng.normal(size=5)
    for number in told_by:
        step = np.array(TAUGHT_CELLS[number])
        x, y = np.array(cell) + step
        for name, value in truth.items():
            offset = np.zeros(len(value)) if name in ("size", "yaw") else np.pad(step, (0, len(value) - 2))
            maps[name][1, :, y, x] = torch.tensor(value + errors[number] - offset)
        maps["depth"][1, 0, y, x] = 3.0 + errors[number]
        maps["log_scale"][1, :, y, x] = float(number)
    found = gather_around(SmallOutputs(**maps), torch.tensor([1]), torch.tensor([cell]), torch.tensor([2]))
    error = errors[told_by].mean()
    for name, value in truth.items():
        np.testing.assert_allclose(getattr(found, name)[0].numpy(), value + error, atol=1e-6)
    assert float(found.depth[0]) == pytest.approx(3.0 + error, abs=1e-6)
    assert found.log_scale[0].tolist() == [0.0] * 5
    assert (found.image.tolist(), found.cells.tolist(), found.classes.tolist()) == ([1], [list(cell)], [2])
