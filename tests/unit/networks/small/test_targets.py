"""What is encoded is what is decoded."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.labelled_views import VEHICLES, camera, view_of
from wibam_core.models.frames import INPUT_WIDTH_PX
from wibam_core.models.peaks import find_peaks
from wibam_core.networks.small.architecture import MEAN_SIZES_M
from wibam_core.networks.small.decode import PeakValues, boxes2d_px, boxes3d
from wibam_core.networks.small.targets import Targets, encode
from wibam_core.placing import Decode
from wibam_core.training.augment import mirror


def as_values(targets: Targets) -> PeakValues:
    n = len(targets.image)
    return PeakValues(
        targets.image,
        targets.cells,
        targets.classes,
        targets.box2d.double(),
        targets.centre3d.double(),
        targets.depth.double(),
        targets.size.double(),
        targets.yaw.double(),
        targets.footprint.double(),
        torch.zeros(n, 5, dtype=torch.float64),
    )


@pytest.mark.parametrize("decode", ["plane", "depth", "ground"])
@pytest.mark.parametrize("dist", [(), (-0.2, 0.05, 0.003, -0.004, 0.01)])
@pytest.mark.parametrize(("height_m", "pitch_rad"), [(1.6, 0.0), (8.0, 0.35)])
def test_decoding_the_targets_gives_the_labels(
    decode: Decode, dist: tuple[float, ...], height_m: float, pitch_rad: float
) -> None:
    view = view_of(VEHICLES, camera(dist, height_m, pitch_rad))
    targets = encode([view, mirror(view)])
    boxes = boxes3d(as_values(targets), targets.cameras, torch.tensor(MEAN_SIZES_M), decode)
    assert (targets.lifted == 1).all()
    np.testing.assert_allclose(boxes.numpy(), targets.boxes3d.numpy(), atol=2e-4 if height_m > 2 else 2e-3)
    first = targets.image == 0
    np.testing.assert_allclose(targets.boxes3d[first].numpy(), VEHICLES[targets.vehicle[first].numpy()])


def test_decoding_the_targets_gives_the_2d_boxes() -> None:
    view = view_of(VEHICLES, camera())
    targets = encode([view])
    np.testing.assert_allclose(boxes2d_px(as_values(targets)).numpy(), view.boxes2d[targets.vehicle.numpy()], atol=1e-3)


def test_peaks_of_the_heat_are_the_vehicles() -> None:
    view = view_of(VEHICLES, camera())
    targets = encode([view])
    peaks = find_peaks(torch.logit(targets.heat.clamp(1e-4, 1 - 1e-4)), 0.9)
    centres = (view.boxes2d[:, :2] + view.boxes2d[:, 2:]) / 2
    found = {tuple(cell) for cell in peaks.cells.tolist()}
    assert found == {tuple(cell) for cell in np.floor((centres + 0.5) / 4).astype(int).tolist()}


def test_convention_alpha_is_yaw_less_the_azimuth_of_the_world_ray() -> None:
    cam = camera(height_m=8.0, pitch_down_rad=0.5)
    vehicle = np.array([[14.0, 6.0, 0.75, 4.4, 1.8, 1.5, 0.3]])
    targets = encode([view_of(vehicle, cam)])
    azimuth = np.arctan2(6.0 + 2.0, 14.0 - 1.0)  # from the camera's foot to the vehicle, whatever the pitch
    alpha = torch.atan2(targets.yaw[:, 0], targets.yaw[:, 1]).numpy()
    np.testing.assert_allclose(alpha, 0.3 - azimuth, atol=1e-6)


def test_depth_is_that_of_the_reference_focal_length() -> None:
    cam = camera()
    longer = replace(cam, K=cam.K * [[1.25, 1, 1], [1, 1.25, 1], [1, 1, 1]])
    one, two = (encode([view_of(VEHICLES[:1], c)]) for c in (cam, longer))
    assert float(one.depth[0] - two.depth[0]) == pytest.approx(np.log(1.25), abs=1e-6)


def test_unlabelled_and_truncated_vehicles_teach_no_3d_values() -> None:
    view = view_of(VEHICLES, camera())
    boxes3d_known = VEHICLES.copy()
    boxes3d_known[1] = np.nan
    shifted = view.boxes2d.copy()
    shifted[0, [0, 2]] += 4 * 15  # the 2D box of a truncated vehicle lies far from its projected centre
    targets = encode([replace(view, boxes3d=boxes3d_known, boxes2d=shifted)])
    assert (targets.lifted == 0).all()
    assert torch.isfinite(targets.centre3d).all()
    assert targets.heat.max() == 1.0


def test_vehicles_count_as_truncated_at_the_same_places_in_wider_images() -> None:
    """A 2D box so far from the projected centre teaches at both widths, and a little farther at neither."""
    cam = camera()
    wide = cam.resized(2 * INPUT_WIDTH_PX, 2 * cam.height_px * INPUT_WIDTH_PX // cam.width_px)
    cam = cam.resized(INPUT_WIDTH_PX, wide.height_px // 2)
    for cells, taught in ((13, 1), (15, 0)):
        for seen_by, scale in ((cam, 1), (wide, 2)):
            view = view_of(VEHICLES[:1], seen_by)
            middle = view.camera.project(VEHICLES[0, :3])[0]
            half = (view.boxes2d[:, 2:] - view.boxes2d[:, :2]) / 2
            at = middle + [4 * scale * cells, 0.0]
            targets = encode([replace(view, boxes2d=np.concatenate([at - half, at + half], axis=1))])
            assert (targets.lifted == taught).all() and len(targets.lifted)


def test_ignored_regions_are_not_judged_but_peaks_in_them_are() -> None:
    view = view_of(VEHICLES, camera())
    targets = encode([replace(view, ignored=np.array([[-0.5, -0.5, 511.5, 287.5]]))])
    assert float(targets.judged.sum()) == 2.0


def test_an_empty_view_has_targets() -> None:
    empty = view_of(np.zeros((0, 7)), camera())
    targets = encode([empty, view_of(VEHICLES, camera())])
    assert set(targets.image.tolist()) == {1}
    assert targets.heat[0].max() == 0
