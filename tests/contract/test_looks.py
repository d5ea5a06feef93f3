"""Looks into recordings and solved cameras over HTTP, and what is refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.builders import look_at
from tests.recordings import write_recording
from tests.service import LiveApi


@pytest.fixture(scope="module")
def recording(api: LiveApi, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The address of an uploaded recording of 2 s."""
    path: Path = tmp_path_factory.mktemp("video") / "noise.mp4"
    write_recording(path, width_px=64, height_px=48, seconds=2.0)
    site = api.site()
    api.upload(site, path.read_bytes())
    [file] = api.http.get(f"/v1/sites/{site}/recordings").json()
    return f"/v1/sites/{site}/recordings/{file['id']}"


class TestFrames:
    def test_the_header_says_length_and_size(self, api: LiveApi, recording: str) -> None:
        answer = api.http.get(f"{recording}/header")
        header = answer.json()
        assert "immutable" in answer.headers["cache-control"], "it is read in a process of its own, which takes a while"
        assert (header["width_px"], header["height_px"]) == (64, 48)
        assert header["duration_s"] == pytest.approx(2.0, abs=0.1)

    @pytest.mark.parametrize("time_s", [0.0, 0.7, 1.5, 100.0])
    def test_a_frame_is_the_last_at_or_before_a_time(self, api: LiveApi, recording: str, time_s: float) -> None:
        answer = api.http.get(f"{recording}/frame", params={"time_s": time_s, "width_px": 32})
        assert answer.status_code == 200, answer.text
        image = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)
        assert image is not None and image.shape == (24, 32, 3)
        shown_s = int(answer.headers["x-wibam-time"]) / 1e9
        assert min(time_s, 2.0) - 0.11 <= shown_s <= max(time_s, 0.05)

    def test_what_is_no_video_says_so(self, api: LiveApi) -> None:
        site = api.site()
        api.upload(site, b"not a video at all" * 100)
        [file] = api.http.get(f"/v1/sites/{site}/recordings").json()
        answer = api.http.get(f"/v1/sites/{site}/recordings/{file['id']}/frame")
        assert (answer.status_code, answer.json()["code"]) == (422, "unreadable_video")
        assert answer.json()["hint"]

    def test_a_recording_that_is_gone_says_so(self, api: LiveApi, recording: str) -> None:
        answer = api.http.get(f"{recording.rpartition('/')[0]}/file_0/frame")
        assert (answer.status_code, answer.json()["code"]) == (404, "not_found")

    @pytest.mark.parametrize("region", ["1,2,3", "a,b,c,d", "0,0,0,10", "0,0,-5,10", "nan,0,5,5"])
    def test_a_region_that_is_none_is_refused(self, api: LiveApi, recording: str, region: str) -> None:
        answer = api.http.get(f"{recording}/signal", params={"region": region})
        assert (answer.status_code, answer.json()["code"]) == (422, "invalid_input")

    def test_noise_shows_no_signal(self, api: LiveApi, recording: str) -> None:
        strip = api.http.get(f"{recording}/signal", params={"region": "4,4,12,30"}).json()
        assert strip["changes"] == []
        assert strip["to_s"] - strip["from_s"] == pytest.approx(2.0, abs=0.2)


class TestSolving:
    WORLD = np.array([[-8, -6, 0], [9, -5, 0], [7, 8, 0], [-6, 9, 0], [0, 1, 0], [3, -2, 0]], dtype=float)

    def body(self) -> dict[str, object]:
        camera = look_at((14.0, -18.0, 7.0))
        pixels, _ = camera.project(self.WORLD)
        points = [{"world": w.tolist(), "pixel": p.tolist()} for w, p in zip(self.WORLD, pixels, strict=True)]
        return {
            "id": "cam1",
            "width_px": camera.width_px,
            "height_px": camera.height_px,
            "calibration": {"kind": "homography", "correspondences": points},
        }

    def test_the_pose_comes_back(self, api: LiveApi) -> None:
        answer = api.http.post("/v1/calibration/solve", json=self.body()).json()
        np.testing.assert_allclose(answer["residuals"]["position_m"], (14.0, -18.0, 7.0), atol=1e-3)
        np.testing.assert_allclose(np.array(answer["camera"]["T_world_cam"])[:, 3], (14.0, -18.0, 7.0), atol=1e-3)
        assert answer["residuals"]["max_px"] < 1e-3

    @pytest.mark.parametrize("kept", [[], [[0.0, 0, 0], [5, 5, 0], [9, 9, 0], [-4, -4, 0], [2, 2, 0]]])
    def test_points_that_give_no_camera_are_said(self, api: LiveApi, kept: list[list[float]]) -> None:
        """Too few, and as many as there must be, but on a line."""
        body, camera = self.body(), look_at((14.0, -18.0, 7.0))
        pixels, _ = camera.project(np.array(kept).reshape(-1, 3))
        points = [{"world": w, "pixel": p.tolist()} for w, p in zip(kept, pixels, strict=True)]
        body["calibration"]["correspondences"] = points  # type: ignore[index]
        answer = api.http.post("/v1/calibration/solve", json=body)
        assert answer.status_code == 200
        said = answer.json()
        assert said["camera"] is said["residuals"] is None
        assert said["problem"]["message"] and said["problem"]["hint"]

    def test_a_body_that_is_no_camera_is_refused(self, api: LiveApi) -> None:
        assert api.http.post("/v1/calibration/solve", json={**self.body(), "width_px": -1}).status_code == 422


class TestReading:
    LENS = "cam0:\n  camera_model: pinhole\n  distortion_model: radtan\n  distortion_coeffs: [-0.1, 0.01, 0, 0]\n"
    LENS += "  intrinsics: [500, 500, 319.5, 179.5]\n  resolution: [640, 360]\n"

    def body(self, **changes: object) -> dict[str, object]:
        return {"camera": TestSolving().body(), "files": [{"name": "chain.yaml", "text": self.LENS}], **changes}

    def test_a_lens_joins_the_points_that_the_site_has(self, api: LiveApi) -> None:
        answer = api.http.post("/v1/calibration/read", json=self.body()).json()
        calibration = answer["camera"]["calibration"]
        assert calibration["kind"] == "pnp" and calibration["K"][0] == [500.0, 0.0, 319.5]
        assert calibration["correspondences"] == TestSolving().body()["calibration"]["correspondences"]  # type: ignore[index]
        assert answer["formats"] == ["Kalibr camchain"]
        assert api.http.post("/v1/calibration/solve", json=answer["camera"]).status_code == 200

    @pytest.mark.parametrize(
        ("file", "words"),
        [
            ({"name": "lens.yaml", "text": "nothing"}, "no known calibration format"),
            ({"name": "bomb.yaml", "text": "a: &a [1]\nK: [*a, *a]\n"}, "no known calibration format"),
            ({"name": "deep.json", "text": "[" * 60_000}, "deep.json"),
        ],
    )
    def test_what_is_no_calibration_is_refused(self, api: LiveApi, file: dict[str, str], words: str) -> None:
        answer = api.http.post("/v1/calibration/read", json=self.body(files=[file]))
        assert answer.status_code == 422
        assert words in answer.json()["detail"]

    def test_a_text_that_is_too_long_is_refused(self, api: LiveApi) -> None:
        file = {"name": "lens.yaml", "text": "x" * 200_000}
        assert api.http.post("/v1/calibration/read", json=self.body(files=[file])).status_code == 422
