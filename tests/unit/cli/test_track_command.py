from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from tests.builders import corner_rig
from tests.recordings import write_recording
from wibam_core.cli.app import app
from wibam_core.config import TrackConfig
from wibam_core.documents.model_card import ModelCard
from wibam_core.errors import CalibrationError, InvalidWeights, MissingCamera
from wibam_core.evaluation.uncertainty import SdFactors
from wibam_core.formats.rig import write_rig
from wibam_core.formats.tracks import read_tracks
from wibam_core.models.frames import Frame
from wibam_core.models.network import Network
from wibam_core.models.weights import bundled
from wibam_core.networks.dla34.architecture import DLA34
from wibam_core.networks.dla34.convert import convert_checkpoint
from wibam_core.networks.dla34.network import CenterTrack
from wibam_core.networks.registry import load_network, save_network
from wibam_core.networks.small.architecture import UNCERTAINTY_GROUPS, SmallNetwork
from wibam_core.networks.small.export import small_onnx
from wibam_core.networks.small.network import CARD, SmallMonocular
from wibam_core.networks.small.onnx_network import OnnxNetwork
from wibam_core.placing import Decode
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import Track, Vehicles3D
from wibam_core.tracking.recording import track_recording
from wibam_core.video.decode import decode
from wibam_core.video.encode import VideoWriter


@pytest.fixture
def video(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "video.mp4", seconds=1.0, width_px=64, height_px=36)


def run(*arguments: str | Path) -> str:
    result = CliRunner().invoke(app, ["track", *map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == 0
    return result.output


def test_without_a_calibration_it_says_that_metres_are_nominal(video: Path, tmp_path: Path) -> None:
    out = tmp_path / "tracks.parquet"
    assert "uncalibrated" in run(video, "--out", out, "--rate", "2")
    assert read_tracks(out) == []  # noise holds no vehicle


def test_with_a_calibration_it_does_not(video: Path, tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.json", corner_rig(2))
    options = ("--calibration", tmp_path / "rig.json", "--camera", "cam2", "--rate", "2")
    assert "nominal" not in run(video, "--out", tmp_path / "tracks.parquet", *options)


@pytest.mark.parametrize(("calibrated", "how"), [(True, "refined"), (False, "plane")])
def test_the_bundled_model_looks_twice_where_the_camera_is_known(
    video: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, calibrated: bool, how: str
) -> None:
    used = []

    def tracked(*arguments: object, decode: Decode, **options: object) -> list[Track]:
        used.append(decode)
        return []

    monkeypatch.setattr("wibam_core.cli.track.track_recording", tracked)
    write_rig(tmp_path / "rig.json", corner_rig(2))
    options = ("--calibration", tmp_path / "rig.json") if calibrated else ()
    run(video, "--out", tmp_path / "tracks.parquet", "--rate", "2", *options)
    assert used == [how]


def test_a_camera_or_shape_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    square = write_recording(tmp_path / "square.mp4", seconds=0.5, width_px=64, height_px=64)
    write_rig(tmp_path / "rig.json", corner_rig(2))
    with pytest.raises(MissingCamera, match="no camera cam9"):
        run(square, "--calibration", tmp_path / "rig.json", "--camera", "cam9")
    with pytest.raises(CalibrationError, match="640x360"):
        run(square, "--calibration", tmp_path / "rig.json")


def test_a_model_may_be_onnx(video: Path, tmp_path: Path) -> None:
    torch.set_num_threads(1)
    exported = load_network(bundled("mono_small.safetensors")).onnx()
    assert exported is not None
    (tmp_path / "model.onnx").write_bytes(exported)
    out = tmp_path / "tracks.parquet"
    run(video, "--out", out, "--rate", "2", "--weights", tmp_path / "model.onnx")
    assert read_tracks(out) == []
    with pytest.raises(InvalidWeights, match="wibam-centre"):
        run(video, "--out", out, "--weights", bundled("detector2d.onnx"))


@pytest.fixture
def still(tmp_path: Path) -> Path:
    """A picture of noise that does not move, in which the networks below see vehicles that stand."""
    noise = np.random.default_rng(0).integers(0, 255, (36, 64, 3), dtype=np.uint8)
    with VideoWriter(tmp_path / "still.mp4", 64, 36, 8.0) as writer:
        for number in range(8):
            writer.write(noise, number * 125_000_000)
    return tmp_path / "still.mp4"


def seeing_network() -> SmallNetwork:
    """Random heat; cars of the mean size, `exp(3)` m away at the reference focal length, with small errors."""
    torch.manual_seed(0)
    network = SmallNetwork().eval()
    biases = {
        "heat": [1.0, -5.0, -5.0, -5.0],
        "box2d": [0.0, 0.0, 1.0, 1.0],
        "log_scale": [-4.0] * len(UNCERTAINTY_GROUPS),
    }
    with torch.no_grad():
        for name, head in network.heads.items():
            head.weight.zero_()
            if name in biases:
                head.bias.copy_(torch.tensor(biases[name]))
        network.heads["heat"].weight[0].normal_(std=0.5)
    return network


def expected(network: Network, still: Path, how: Decode, factors: SdFactors = SdFactors()) -> list[Track]:
    config = TrackConfig(rate_hz=8.0, min_score=0.3)
    camera = corner_rig(2)["cam1"]
    return track_recording(network, decode(still), camera, config, decode=how, factors=factors)


def assert_same(found: list[Track], want: list[Track]) -> None:
    assert len(found) == len(want) > 0
    for one, other in zip(found, want, strict=True):
        np.testing.assert_allclose(one.boxes, other.boxes, atol=1e-3)
        np.testing.assert_allclose(one.sd, other.sd, atol=1e-3)


def places(tracks: list[Track]) -> list[list[float]]:
    return [track.boxes[0, :2].round(1).tolist() for track in tracks]


@pytest.mark.parametrize("suffix", ["safetensors", "onnx"])
def test_a_model_is_used_as_it_says(still: Path, tmp_path: Path, suffix: str) -> None:
    torch.set_num_threads(1)
    network = seeing_network()
    write_rig(tmp_path / "rig.json", corner_rig(2))

    def tracks(card: ModelCard = CARD) -> list[Track]:
        weights, out = tmp_path / f"model.{suffix}", tmp_path / "tracks.parquet"
        if suffix == "onnx":
            weights.write_bytes(small_onnx(network, card))
        else:
            save_network(SmallMonocular(network, card), weights)
        run(still, "--out", out, "--rate", "8", "--weights", weights, "--calibration", tmp_path / "rig.json")
        return read_tracks(out)

    ours = OnnxNetwork.of(small_onnx(network, CARD))
    plane, depth = expected(ours, still, "plane"), expected(ours, still, "depth")
    assert places(plane) != places(depth)
    unsure = expected(ours, still, "depth", SdFactors(position=3.0))
    assert np.median(unsure[0].sd[:, 0]) > 1.5 * np.median(depth[0].sd[:, 0])
    assert_same(tracks(), plane)
    assert_same(tracks(CARD.model_copy(update={"decode": "depth"})), depth)
    assert_same(tracks(CARD.model_copy(update={"decode": "depth", "sd_factors": {"position": 3.0}})), unsure)


@pytest.fixture(scope="module")
def centertrack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Converted weights, random but for heads that see cars about 20 m away wherever the noise is bright."""
    folder = tmp_path_factory.mktemp("centertrack")
    torch.set_num_threads(1)
    torch.manual_seed(0)
    network = DLA34()
    with torch.no_grad():
        for head, values in {"dim": [1.6, 1.9, 4.5], "dep": [-3.0], "wh": [20.0, 15.0]}.items():
            network.get_submodule(head)[2].bias.copy_(torch.tensor(values))
        network.hm[2].bias[0] = 2.0
        network.hm[2].weight.normal_(std=0.3)
    torch.save({"state_dict": network.state_dict()}, folder / "w.pth")
    convert_checkpoint(folder / "w.pth", folder / "w.safetensors")
    return folder / "w.safetensors"


@pytest.mark.parametrize("calibrated", [True, False])
def test_centertracks_weights_are_the_detector(centertrack: Path, tmp_path: Path, calibrated: bool) -> None:
    noise = write_recording(tmp_path / "noise.mp4", seconds=0.5, fps=8.0, width_px=64, height_px=36)
    write_rig(tmp_path / "rig.json", corner_rig(2))
    options = ("--calibration", tmp_path / "rig.json") if calibrated else ()
    out = tmp_path / "tracks.parquet"
    said = run(noise, "--out", out, "--weights", centertrack, "--rate", "8", *options)
    assert "non-commercial use only" in said
    assert ("uncalibrated" in said) != calibrated
    tracks = read_tracks(out)
    assert tracks
    for track in tracks:
        assert track.vehicle_class is RoadUserClass.CAR
        np.testing.assert_allclose(track.boxes[:, 3:6], [[4.5, 1.9, 1.6]] * len(track), atol=0.5)


def test_a_fine_tuned_dla34_is_used_as_it_says(
    centertrack: Path, still: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    used: list[str] = []

    def nothing(
        network: CenterTrack, frames: Iterable[Frame], *, decodes: Sequence[str], min_score: float
    ) -> Iterator[tuple[Vehicles3D, ...]]:
        used.extend(decodes)
        for frame in frames:
            yield (Vehicles3D.of(frame.time_ns, np.zeros((0, 7)), camera_id=frame.camera_id),)

    monkeypatch.setattr(CenterTrack, "predict_each", nothing)
    trained = load_network(centertrack)
    trained.card = trained.card.model_copy(update={"decode": "plane"})
    save_network(trained, tmp_path / "plane.safetensors")
    for weights in (centertrack, tmp_path / "plane.safetensors"):
        run(still, "--out", tmp_path / "tracks.parquet", "--rate", "2", "--weights", weights)
    assert used == ["depth", "plane"]


@pytest.mark.assets
def test_centertracks_network_runs_on_the_real_clip(assets: Path, centertrack: Path, tmp_path: Path) -> None:
    first = list(islice(decode(assets / "footage" / "traffic.mp4"), 5))
    height_px, width_px = first[0][1].shape[:2]
    with VideoWriter(tmp_path / "first.mp4", width_px, height_px, 24.0) as writer:
        for time_ns, image in first:
            writer.write(image, time_ns)
    run(tmp_path / "first.mp4", "--out", tmp_path / "tracks.parquet", "--weights", centertrack, "--rate", "24")
    tracks = read_tracks(tmp_path / "tracks.parquet")
    assert tracks
    assert all(np.isfinite(track.boxes).all() for track in tracks)
