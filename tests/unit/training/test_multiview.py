"""The published loss, against a plain loop."""

import numpy as np
import pytest
import torch

from tests.builders import corner_rig
from wibam_core.geometry.box3d import EDGES, corners
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.projection import EDGE_SHARES
from wibam_core.geometry.torch_ops import CameraTensors
from wibam_core.training.multiview import NEAR_M, OtherViews, multiview_loss


def giou_of(a: np.ndarray, b: np.ndarray) -> float:
    width = max(0.0, min(a[2], b[2]) - max(a[0], b[0]))
    height = max(0.0, min(a[3], b[3]) - max(a[1], b[1]))
    overlap = width * height
    union = (a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - overlap
    hull = (max(a[2], b[2]) - min(a[0], b[0])) * (max(a[3], b[3]) - min(a[1], b[1]))
    return overlap / union - (hull - union) / hull


def loop_loss(boxes: np.ndarray, pairs: list[tuple[int, Camera, np.ndarray]]) -> float:
    """Vehicle by vehicle, view by view, with points along the edges where a lens bends them."""
    means = []
    for index, box in enumerate(boxes):
        losses = []
        for vehicle, cam, given in pairs:
            if vehicle != index:
                continue
            ends = corners(box)[EDGES]
            share = (EDGE_SHARES if cam.has_distortion else np.array([0.0, 1.0]))[:, None, None]
            uv, depth = cam.project(((1 - share) * ends[:, 0] + share * ends[:, 1]).reshape(-1, 3))
            if depth.min() < NEAR_M:
                continue
            low = np.clip(uv.min(axis=0), -0.5, [cam.width_px - 0.5, cam.height_px - 0.5])
            high = np.clip(uv.max(axis=0), -0.5, [cam.width_px - 0.5, cam.height_px - 0.5])
            if (high <= low).any():
                continue
            losses.append(1 - giou_of(np.concatenate([low, high]), given))
        if losses:
            means.append(np.mean(losses))
    return float(np.mean(means)) if means else 0.0


def scene(
    seed: int, dist: tuple[float, ...] = ()
) -> tuple[np.ndarray, list[tuple[int, Camera, np.ndarray]], OtherViews]:
    rng = np.random.default_rng(seed)
    cameras = list(corner_rig(4, dist=dist).values())
    n = 7
    boxes = np.column_stack(
        [
            rng.uniform(-20, 20, (n, 2)),
            np.full(n, 0.8),
            rng.uniform([3, 1.5, 1.2], [9, 2.5, 3], (n, 3)),
            rng.uniform(-3, 3, n),
        ]
    )
    boxes[0, :2] = cameras[0].centre_m[:2]  # below a camera, partly behind another
    pairs = []
    for vehicle in range(n - 1):  # the last vehicle has no other view
        for index in rng.permutation(4)[: rng.integers(1, 4)]:
            corner = rng.uniform([0, 0], [500, 250])
            pairs.append((vehicle, int(index), np.concatenate([corner, corner + rng.uniform(20, 120, 2)])))
    views = OtherViews(
        torch.tensor([p[0] for p in pairs]),
        torch.tensor([p[1] for p in pairs]),
        torch.tensor(np.stack([p[2] for p in pairs])),
        CameraTensors.from_cameras(cameras, torch.float64),
    )
    return boxes, [(v, cameras[c], b) for v, c, b in pairs], views


@pytest.mark.parametrize("dist", [(), (-0.15, 0.02, 0.001, -0.001, 0.0)])
@pytest.mark.parametrize("seed", range(5))
def test_equals_a_loop_over_vehicles_and_views(seed: int, dist: tuple[float, ...]) -> None:
    boxes, pairs, views = scene(seed, dist)
    loss = multiview_loss(torch.tensor(boxes), views)
    assert float(loss) == pytest.approx(loop_loss(boxes, pairs), abs=1e-6)


@pytest.mark.parametrize("dist", [(), (-0.15, 0.02, 0.001, -0.001, 0.0)])
def test_gradients_are_right(dist: tuple[float, ...]) -> None:
    boxes, _, views = scene(1, dist)
    leaf = torch.tensor(boxes, requires_grad=True)
    assert torch.autograd.gradcheck(lambda b: multiview_loss(b, views), (leaf,), eps=1e-6, atol=1e-5)


def cut_by_the_border() -> tuple[torch.Tensor, OtherViews, Camera]:
    """A vehicle that sticks out of an image on the left, and another that does on the right and below."""
    cam = next(iter(corner_rig(4).values()))
    at_border = [cam.rays(np.array(pixel)) for pixel in ((-0.5, 200.0), (639.5, 340.0))]
    middles = [cam.centre_m + ray * (0.8 - cam.centre_m[2]) / ray[2] for ray in at_border]
    boxes = np.array([[*middle[:2], 0.8, 4.5, 1.8, 1.6, 0.7] for middle in middles])
    uv = np.stack([cam.project(corners(box))[0] for box in boxes])
    given = np.clip(np.concatenate([uv.min(axis=1), uv.max(axis=1)], axis=1), -0.5, [639.5, 359.5, 639.5, 359.5])
    both = torch.tensor([0, 1])
    views = OtherViews(both, both * 0, torch.tensor(given), CameraTensors.from_cameras([cam], torch.float64))
    return torch.tensor(boxes, requires_grad=True), views, cam


def test_boxes_cut_by_the_border_fit_cut_reprojections() -> None:
    boxes, views, cam = cut_by_the_border()
    assert views.boxes[0, 0] == -0.5
    assert views.boxes[1, 2:].tolist() == [639.5, 359.5]
    assert multiview_loss(boxes, views).item() < 1e-9
    longer = (boxes + torch.tensor([0.0, 0, 0, 1.0, 0, 0, 0])).detach().requires_grad_()
    pairs = [(number, cam, views.boxes[number].numpy()) for number in range(2)]
    loss = multiview_loss(longer, views)
    assert loss.item() == pytest.approx(loop_loss(longer.detach().numpy(), pairs), abs=1e-6)
    assert loss.item() > 0.01
    assert torch.autograd.gradcheck(lambda b: multiview_loss(b, views), (longer,), eps=1e-6, atol=1e-5)


def test_vehicles_with_perfect_boxes_cost_nothing() -> None:
    boxes, _, views = scene(2)
    perfect = []
    for vehicle, camera_index in zip(views.vehicle.tolist(), views.camera.tolist(), strict=True):
        cam = list(corner_rig(4).values())[camera_index]
        uv, _ = cam.project(corners(boxes[vehicle]))
        limits = [cam.width_px - 0.5, cam.height_px - 0.5]
        perfect.append(np.clip(np.concatenate([uv.min(axis=0), uv.max(axis=0)]), -0.5, limits * 2))
    views = OtherViews(views.vehicle, views.camera, torch.tensor(np.nan_to_num(np.stack(perfect))), views.cameras)
    assert float(multiview_loss(torch.tensor(boxes), views)) < 1e-6


def test_without_any_view_the_loss_is_zero_and_has_a_gradient() -> None:
    boxes, _, views = scene(3)
    nothing = torch.zeros(0, dtype=torch.int64)
    empty = OtherViews(nothing, nothing, torch.zeros(0, 4, dtype=torch.float64), views.cameras)
    leaf = torch.tensor(boxes, requires_grad=True)
    loss = multiview_loss(leaf, empty)
    loss.backward()
    assert loss.item() == 0.0
    assert torch.isfinite(leaf.grad).all()


def test_a_corner_behind_the_camera_leaves_the_gradient_finite() -> None:
    cameras = list(corner_rig(4).values())
    leaf = torch.tensor([[*cameras[0].centre_m[:2], 6.5, 9.0, 2.5, 3.0, 0.3]], requires_grad=True, dtype=torch.float64)
    views = OtherViews(
        torch.tensor([0, 0]),
        torch.tensor([0, 2]),
        torch.tensor([[10.0, 10, 60, 60], [300, 100, 360, 160]], dtype=torch.float64),
        CameraTensors.from_cameras(cameras, torch.float64),
    )
    multiview_loss(leaf, views).backward()
    assert torch.isfinite(leaf.grad).all()
    assert (leaf.grad != 0).any()
