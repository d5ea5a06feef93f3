"""Boxes from all that the heads say about them."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.builders import look_at
from wibam_core.geometry.pixels import resized_px
from wibam_core.geometry.torch_ops import (
    CameraTensors,
    azimuths_rad,
    focal_px,
    project,
    rays,
    vehicle_to_world,
    wrap_angle,
)
from wibam_core.models.second_look import Edges
from wibam_core.models.trunk import STRIDE
from wibam_core.networks.small.architecture import MEAN_SIZES_M, REFERENCE_FOCAL_PX
from wibam_core.networks.small.decode import PeakValues, boxes3d, standard_deviations
from wibam_core.networks.small.reconcile import covered_edges, edges_within, reconciled
from wibam_core.road_users import BODIES

SIZES = torch.tensor(MEAN_SIZES_M)
#: One for each vehicle, all of them different, half of them with distortion.
CAMERAS = CameraTensors.from_cameras(
    [
        replace(
            look_at((20.0 * np.cos(k), 20.0 * np.sin(k), 6.0 + k % 3), focal_px=400.0, width_px=640, height_px=384),
            dist=np.array([-0.2, 0.05, 0.0, 0.0][: 4 * (k % 2)]),
        )
        for k in range(64)
    ],
    torch.float64,
)


def cells_of_px(pixels: Tensor) -> Tensor:
    """Fractional cells, the first of which is centred in the first four pixels."""
    return (pixels - 1.5) / 4


def fitted(
    values: PeakValues, boxes: Tensor, sd: Tensor, cameras: CameraTensors, edges: Edges | None = None
) -> tuple[Tensor, Tensor]:
    return reconciled(values, boxes, sd, cameras, torch.tensor(BODIES)[values.classes], edges)


def vehicles(n: int = 24, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Boxes (n, 7) in view of the camera, not near its border, and classes (n,)."""
    rng = np.random.default_rng(seed)
    classes = torch.tensor(rng.integers(0, 4, n))
    size = SIZES.double()[classes] * torch.tensor(np.exp(rng.normal(0, 0.06, (n, 3))))
    place = torch.tensor(rng.uniform(-4, 4, (n, 2)))
    yaw = torch.tensor(rng.uniform(-np.pi, np.pi, (n, 1)))
    return torch.cat([place, size[:, 2:] / 2, size, yaw], dim=1), classes


def body_px(boxes: Tensor, classes: Tensor) -> Tensor:
    body = vehicle_to_world(boxes, torch.tensor(BODIES)[classes] * boxes[:, None, 3:6])
    return project(CAMERAS[: len(boxes)], body)[0]


def outline_px(boxes: Tensor, classes: Tensor) -> Tensor:
    pixels = body_px(boxes, classes)
    return torch.cat([pixels.amin(dim=1), pixels.amax(dim=1)], dim=1)


def told(boxes: Tensor, classes: Tensor, log_scale: tuple[float, ...] = (-3.0,) * 5) -> PeakValues:
    """What heads that know all say of boxes, one in each image."""
    n = len(boxes)
    seen_by = CAMERAS[:n]
    edges = outline_px(boxes, classes)
    middle = resized_px((edges[:, :2] + edges[:, 2:]) / 2, 1 / STRIDE)
    cells = middle.round()
    centre, depth = project(seen_by, boxes[:, :3])
    footprint, _ = project(seen_by, boxes[:, :3] * torch.tensor([1.0, 1.0, 0.0]))
    alpha = boxes[:, 6] - azimuths_rad(rays(seen_by, centre))
    return PeakValues(
        torch.arange(n),
        cells.long(),
        classes,
        torch.cat([middle - cells, ((edges[:, 2:] - edges[:, :2]) / STRIDE).log()], dim=1),
        resized_px(centre, 1 / STRIDE) - cells,
        (depth * REFERENCE_FOCAL_PX / focal_px(seen_by)).log(),
        (boxes[:, 3:6] / SIZES.double()[classes]).log(),
        torch.stack([alpha.sin(), alpha.cos()], dim=1),
        resized_px(footprint, 1 / STRIDE) - cells,
        torch.tensor(log_scale).double().expand(n, 5),
    )


def blurred(values: PeakValues, seed: int) -> PeakValues:
    """With normal errors as large as the values say of themselves, and edges a pixel off."""
    rng = np.random.default_rng(seed)
    sd = values.log_scale.exp() * 2**0.5

    def noise(columns: int, group: int) -> Tensor:
        return torch.tensor(rng.normal(size=(len(sd), columns))) * sd[:, [group]]

    turn = noise(1, 3)[:, 0]
    alpha = torch.atan2(values.yaw[:, 0], values.yaw[:, 1]) + turn
    return replace(
        values,
        box2d=values.box2d + torch.tensor(rng.normal(0, 0.1, values.box2d.shape)) * torch.tensor([1.0, 1.0, 0.1, 0.1]),
        centre3d=values.centre3d + noise(2, 0),
        depth=values.depth + noise(1, 1)[:, 0],
        size=values.size + noise(3, 2),
        yaw=torch.stack([alpha.sin(), alpha.cos()], dim=1),
        footprint=values.footprint + noise(2, 4),
    )


def both(values: PeakValues) -> tuple[Tensor, Tensor, Tensor]:
    """Boxes where the fits start, then fitted ones and their standard deviations."""
    cameras = CAMERAS[: len(values.image)]
    start = boxes3d(values, cameras, SIZES, "fitted")
    found, sd = fitted(values, start, standard_deviations(values, start, cameras, "fitted"), cameras)
    return start, found, sd


def test_heads_that_agree_are_believed() -> None:
    boxes, classes = vehicles()
    start, found, _ = both(told(boxes, classes))
    torch.testing.assert_close(start, boxes, atol=1e-6, rtol=0)
    torch.testing.assert_close(found, boxes, atol=1e-4, rtol=0)


def test_heads_that_err_correct_each_other() -> None:
    boxes, classes = vehicles(60)
    start, found, sd = both(blurred(told(boxes, classes, (-0.5, -2.0, -2.5, -3.0, -0.5)), seed=1))

    def errors(given: Tensor) -> tuple[Tensor, Tensor]:
        return torch.linalg.norm((given - boxes)[:, :2], dim=1), (given / boxes)[:, 3:6].log().abs()

    for before, after in zip(errors(start), errors(found), strict=True):
        assert float(after.mean()) < 0.8 * float(before.mean())
    assert bool((found[:, 2] - found[:, 5] / 2).abs().max() < 1e-9)
    error = found - boxes
    error[:, 6] = wrap_angle(error[:, 6])
    for columns in ([0, 1], [3, 4, 5], [6]):
        assert 0.5 < float((error / sd)[:, columns].square().mean().sqrt()) < 1.5, columns


def test_uncertainties_say_whom_to_believe() -> None:
    boxes, classes = vehicles()
    values = told(boxes, classes)
    wrong = replace(values, footprint=values.footprint + 2.0)
    unsure = values.log_scale.clone()
    unsure[:, 4] = 2.0
    _, trusted, _ = both(wrong)
    _, found, _ = both(replace(wrong, log_scale=unsure))
    away, near = (float(torch.linalg.norm((b - boxes)[:, :2], dim=1).mean()) for b in (trusted, found))
    assert near < 0.1 * away


def test_what_leads_nowhere_stays_where_it_was() -> None:
    boxes, classes = vehicles()
    values = told(boxes, classes)
    unsure = values.log_scale + 4.0
    for torn in (  # higher in the image and so farther away, or much larger
        replace(values, box2d=values.box2d - torch.tensor([0.0, 10.0, 0.0, 0.0]), log_scale=unsure),
        replace(values, box2d=values.box2d + torch.tensor([0.0, 0.0, 1.0, 1.0]), log_scale=unsure),
    ):
        start, found, sd = both(torn)
        begun_with = standard_deviations(torn, start, CAMERAS[:24], "fitted")
        stayed = (found == start).all(dim=1)
        assert int(stayed.sum()) > 12
        assert torch.equal(sd[stayed], begun_with[stayed])
        assert float(torch.linalg.norm((found - start)[:, :2], dim=1).max()) <= 3.0
        assert float((found / start)[:, 3:6].log().abs().max()) <= 0.5


def test_vehicles_under_the_camera_and_at_the_horizon_stay_plausible() -> None:
    boxes, classes = vehicles()
    values = told(boxes, classes)
    for rows in (-40.0, 40.0):
        moved = {name: getattr(values, name).clone() for name in ("footprint", "centre3d")}
        for value in moved.values():
            value[:, 1] += rows
        start, found, sd = both(replace(values, **moved))
        assert bool((found.isfinite() & sd.isfinite()).all() & (sd >= 0).all())
        assert float((found / start)[:, 3:6].log().abs().max()) <= 0.5
    assert both(told(*vehicles(0)))[1].shape == (0, 7)


@pytest.mark.parametrize("number", [np.nan, np.inf])
@pytest.mark.parametrize("head", ["depth", "box2d", "log_scale"])
def test_a_head_that_is_not_finite_spoils_its_own_fit_alone(head: str, number: float) -> None:
    boxes, classes = vehicles()
    values = blurred(told(boxes, classes), seed=4)
    whole = both(values)[1]
    broken = getattr(values, head).clone()
    broken[3] = number
    start, found, _ = both(replace(values, **{head: broken}))
    others = torch.arange(len(boxes)) != 3
    torch.testing.assert_close(found[others], whole[others])
    assert torch.allclose(found[3], start[3], equal_nan=True) or bool(found[3].isfinite().all())


def test_a_vehicle_that_the_border_cuts_is_as_long_as_its_heads_say() -> None:
    """The image shows a part of it alone: its right edge is the border, and others may be those of that part."""
    boxes, classes = vehicles(40, seed=3)
    values = told(boxes, classes)
    pixels = body_px(boxes, classes)
    left, right = pixels[..., 0].amin(dim=1), pixels[..., 0].amax(dim=1)
    width = left + 0.6 * (right - left)
    cameras = CAMERAS[:40]
    narrow = replace(cameras, size=torch.stack([width, torch.full_like(width, 384.0)], dim=1))
    shown = pixels[..., 0] < width[:, None] - 0.5
    rows = pixels[..., 1]
    top = torch.where(shown, rows, torch.inf).amin(dim=1)
    bottom = torch.where(shown, rows, -torch.inf).amax(dim=1)
    low, high = torch.stack([left, top], dim=1), torch.stack([width - 1, bottom], dim=1)
    centre = resized_px((low + high) / 2, 1 / STRIDE) - values.cells
    seen = replace(values, box2d=torch.cat([centre, ((high - low) / STRIDE).log()], dim=1))
    found, _ = fitted(seen, boxes, torch.ones_like(boxes), narrow)
    torch.testing.assert_close(found, boxes, atol=1e-3, rtol=0)
    found, _ = fitted(seen, boxes, torch.ones_like(boxes), cameras)
    assert float((found - boxes).abs().max()) > 0.1


@pytest.mark.parametrize(
    ("other", "image", "hidden"),
    [
        ((150.0, 120.0, 260.0, 210.0), 0, [False, False, True, True]),  # nearer, over the lower right corner
        ((150.0, 120.0, 260.0, 190.0), 0, [False, False, False, False]),  # farther away: behind
        ((150.0, 120.0, 260.0, 210.0), 1, [False, False, False, False]),  # in another image
        ((195.0, 190.0, 260.0, 210.0), 0, [False, False, False, False]),  # over a corner alone
        ((90.0, 90.0, 210.0, 210.0), 0, [True, True, True, True]),
    ],
)
def test_edges_behind_a_nearer_vehicle_are_not_compared(
    other: tuple[float, ...], image: int, hidden: list[bool]
) -> None:
    boxes = torch.tensor([(100.0, 100.0, 200.0, 200.0), other])
    found = covered_edges(boxes, torch.tensor([0, image]))
    assert found[0].tolist() == hidden
    assert bool(found[1].any()) == (other[3] < 200.0 and image == 0)  # the first hides it


def test_edges_at_the_border_are_not_compared() -> None:
    boxes = torch.tensor([(1.0, 50.0, 638.0, 383.0)])
    # the top is made by a point within the image, or by one beyond the left border
    for x, top in ((300.0, True), (-20.0, False)):
        outline = torch.tensor([[(-30.0, 200.0), (x, 50.0), (700.0, 210.0), (320.0, 400.0)]])
        told = edges_within(boxes, outline, torch.tensor([[640.0, 384.0]]))
        assert told.tolist() == [[False, top, False, False]]


def test_edges_of_a_second_look_count_as_far_as_they_are_sure() -> None:
    """Heads that err, edges of the bodies, and the same edges 20 px off, of which nothing is sure or a little."""
    boxes, classes = vehicles(60)
    values = blurred(told(boxes, classes, (-0.5, -2.0, -2.5, -3.0, -0.5)), seed=1)
    start, plain, _ = both(values)
    edges = outline_px(boxes, classes)
    spoilt = replace(values, box2d=values.box2d + 3.0)  # what they are given instead of

    def error(px: Tensor, sd_px: float) -> float:
        given = Edges(px, torch.full_like(px, sd_px))
        found, _ = fitted(spoilt, start, torch.ones_like(start), CAMERAS[: len(boxes)], given)
        return float(torch.linalg.norm((found - boxes)[:, :2], dim=1).mean())

    usual = float(torch.linalg.norm((plain - boxes)[:, :2], dim=1).mean())
    assert error(edges, 0.1) < 0.85 * usual
    assert error(edges, 0.1) < error(edges, 5.0) < error(edges + 20.0, 5.0)
    assert error(edges, np.inf) == error(edges + 20.0, np.inf) == pytest.approx(error(edges + 20.0, 1e4), rel=1e-3)


def test_edges_of_a_second_look_may_turn_vehicles_more_than_those_of_2d_boxes() -> None:
    """Both as certain as each other, beside a heading that is off."""
    boxes, classes = vehicles(60)
    values = told(boxes, classes, (-3.0, -3.0, -3.0, -2.0, -3.0))
    alpha = torch.atan2(values.yaw[:, 0], values.yaw[:, 1]) + 0.2
    values = replace(values, yaw=torch.stack([alpha.sin(), alpha.cos()], dim=1))
    start, plain, _ = both(values)
    px = outline_px(boxes, classes)
    as_sure = 0.7 + 0.03 * (px[:, 2:] - px[:, :2]).repeat(1, 2)
    beside, _ = fitted(
        values, start, torch.ones_like(start), CAMERAS[:60], Edges(px, (as_sure.square() - 0.3**2).sqrt())
    )
    by_boxes, by_edges = (float(wrap_angle(found[:, 6] - boxes[:, 6]).abs().mean()) for found in (plain, beside))
    assert by_edges < 0.9 * by_boxes < 0.9 * 0.2


def test_vehicles_do_not_hide_edges_of_a_second_look() -> None:
    """They are those of the whole vehicle: one that stands in front changes nothing."""
    boxes, classes = vehicles()
    values = blurred(told(boxes, classes, (-0.5, -2.0, -2.5, -3.0, -0.5)), seed=1)  # so that edges change something
    edges = Edges(outline_px(boxes, classes), torch.full((24, 4), 0.5, dtype=torch.float64))
    start = boxes + torch.tensor([0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    alone, _ = fitted(values, start, torch.ones_like(start), CAMERAS[:24], edges)
    one = {name: value[[0, 0]] for name, value in vars(values).items()}
    one["box2d"] = one["box2d"] + torch.tensor([[0.0] * 4, [0.0, 0.5, 0.0, 0.0]])  # the same, but lower
    both_px = Edges(edges.px[[0, 0]], edges.sd_px[[0, 0]])
    beside, _ = fitted(PeakValues(**one), start[[0, 0]], torch.ones(2, 7).double(), CAMERAS[:1], both_px)
    torch.testing.assert_close(beside[0], alone[0])


def test_angles_are_wrapped() -> None:
    boxes, classes = vehicles()
    boxes[:, 6] = np.pi - 1e-3
    _, found, _ = both(blurred(told(boxes, classes), seed=2))
    assert bool((found[:, 6].abs() <= np.pi).all())
    assert float(wrap_angle(found[:, 6] - boxes[:, 6]).abs().max()) < 0.3
