"""How long labelling takes in a browser and how exact it is, on a simulated site whose truth is known.

    python -m benchmarks.labelling http://127.0.0.1:8000 TOKEN JOB SITE/labels.parquet

The job must have been run on that site. A fixed script labels the six vehicles that cameras see largest at each of the
instants that are suggested first, once from the job's proposals and once from nothing, by mouse and keys, with a pause
after every action. Whom no proposal overlaps it places anew. It knows where the vehicles are: what it measures is how
fast and how exact the page lets somebody be who sees as well as that, and not how well people see. Printed are the
seconds by the clock, in which a busy machine waits, too, and the actions, whose pauses alone take 0.15 s each.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import numpy as np

from wibam_core.evaluation.labels_at import LabelTimeline
from wibam_core.formats.labels import read_labels
from wibam_core.geometry.box3d import HEIGHT, LENGTH, WIDTH, XY, YAW
from wibam_core.geometry.boxes2d import areas_px2
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.iou import bev_iou, bev_iou_paired
from wibam_core.geometry.projection import project_boxes
from wibam_core.geometry.se3 import SE3, normalise_angle
from wibam_core.scene import FloatArray, LabelledInstant

if TYPE_CHECKING:
    from playwright.sync_api import Page

VEHICLES = 6
PAUSE_MS = 150
#: A proposal that overlaps this much is left as it is.
GOOD_ENOUGH_IOU = 0.93
SIZE_STEP_M, MOVE_STEP_M, SEEN = 0.05, 0.05, 0.5


class Script:
    """What somebody does at one instant."""

    def __init__(self, page: Page, labels: Any, cameras: dict[str, Camera]) -> None:
        self.page, self.labels, self.cameras = page, labels, cameras
        self.actions = 0

    def pause(self) -> None:
        """After an action."""
        self.actions += 1
        self.page.wait_for_timeout(PAUSE_MS)

    def press(self, key: str, times: int = 1) -> None:
        for _ in range(times):
            self.page.keyboard.press(key)
            self.pause()

    def steps(self, key: str, count: int) -> None:
        """Coarse steps first, ten times as large."""
        coarse, fine = divmod(count, 10)
        self.press(f"Shift+{key.upper() if len(key) == 1 else key}", coarse)
        self.press(key, fine)

    def boxes(self) -> dict[int, FloatArray]:
        """As they are saved."""
        while self.page.evaluate("Object.keys(localStorage).some((key) => key.startsWith('wibam-labels '))"):
            self.page.wait_for_timeout(PAUSE_MS / 3)
        return {vehicle["id"]: np.array(vehicle["box"]) for vehicle in self.labels()["vehicles"]}

    def correct(self, box: FloatArray, truth: FloatArray) -> None:
        """Size, heading and place of the chosen vehicle, by keys."""
        for key, column in (("l", LENGTH), ("w", WIDTH), ("h", HEIGHT)):
            by = truth[column] - box[column]
            coarse, fine = divmod(round(abs(by) / SIZE_STEP_M), 10)
            alt = "Alt+" if by < 0 else ""
            self.press(f"{alt}Shift+{key.upper()}", coarse)
            self.press(f"{alt}{key}", fine)
        turn = float(np.degrees(normalise_angle(truth[YAW] - box[YAW])))
        self.steps("q" if turn > 0 else "e", round(abs(turn)))
        c, s = np.cos(truth[YAW]), np.sin(truth[YAW])
        forward, left = np.array([[c, s], [-s, c]]) @ (truth[XY] - box[XY])
        for by, ahead, back in ((forward, "ArrowUp", "ArrowDown"), (left, "ArrowLeft", "ArrowRight")):
            self.steps(ahead if by > 0 else back, round(abs(by) / MOVE_STEP_M))

    def place(self, camera_id: str, truth: FloatArray) -> None:
        """A new vehicle, pulled from where it stands to where it heads."""
        ground = np.array([*truth[XY], 0.0])
        ends = [ground, ground + 3.0 * np.array([np.cos(truth[YAW]), np.sin(truth[YAW]), 0.0])]
        camera = self.cameras[camera_id]
        place = self.page.get_by_label(f"Frame of camera {camera_id} with").bounding_box()
        assert place is not None
        scale = place["width"] / camera.width_px
        start, end = ((camera.project(point)[0] + 0.5) * scale + [place["x"], place["y"]] for point in ends)
        self.press("n")
        self.page.mouse.move(*start)
        self.page.mouse.down()
        self.page.mouse.move(*(start + end) / 2)
        self.page.mouse.move(*end)
        self.page.mouse.up()
        self.pause()

    def anew(self, camera_id: str, truth: FloatArray) -> int:
        """Place a vehicle and put it right; returns its id."""
        self.place(camera_id, truth)
        found = self.boxes()
        self.correct(found[max(found)], truth)
        return max(found)

    def from_proposals(self, truths: FloatArray, best: list[str]) -> list[int]:
        self.press("p")
        found, ids = self.boxes(), []
        for truth, camera_id in zip(truths, best, strict=True):
            overlaps = {id_: float(bev_iou(box, truth)[0, 0]) for id_, box in found.items()}
            id_ = max(overlaps, key=lambda one: overlaps[one])
            if overlaps[id_] == 0:
                id_ = self.anew(camera_id, truth)
            elif overlaps[id_] < GOOD_ENOUGH_IOU:
                self.page.select_option("#present", str(id_))
                self.page.evaluate("document.activeElement.blur()")
                self.pause()
                self.correct(found[id_], truth)
            ids.append(id_)
        return ids

    def from_nothing(self, truths: FloatArray, best: list[str]) -> list[int]:
        return [self.anew(camera_id, truth) for truth, camera_id in zip(truths, best, strict=True)]


def cameras_of(scene: dict[str, Any]) -> dict[str, Camera]:
    """The cameras of a job as the API says them."""
    found = {}
    for one in scene["cameras"]:
        pose = np.array(one["T_world_cam"])
        found[one["id"]] = Camera(
            np.array(one["K"]), np.array(one["dist"]), SE3(pose[:, :3], pose[:, 3]), one["width_px"], one["height_px"]
        )
    return found


def largest(truth: LabelledInstant, cameras: dict[str, Camera]) -> tuple[FloatArray, list[str]]:
    """(VEHICLES, 7) those that some camera sees largest, and which camera that is."""
    boxes = truth.vehicles.boxes
    areas = np.stack(
        [
            np.nan_to_num(areas_px2(project_boxes(camera, boxes)))
            * (np.asarray(truth.visibility.get(camera_id, np.zeros(len(boxes)))) > SEEN)
            for camera_id, camera in cameras.items()
        ]
    )
    rows = np.argsort(-areas.max(axis=0), kind="stable")[:VEHICLES]
    return boxes[rows], [list(cameras)[k] for k in areas.argmax(axis=0)[rows]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("url", "token", "job"):
        parser.add_argument(name)
    parser.add_argument("truth", type=Path)
    parser.add_argument("--instants", type=int, default=3)
    parser.add_argument("--chromium", default="/usr/bin/chromium")
    given = parser.parse_args()
    from playwright.sync_api import sync_playwright

    http = httpx.Client(base_url=f"{given.url}/v1/jobs/{given.job}", headers={"Authorization": f"Bearer {given.token}"})
    cameras = cameras_of(http.get("/scene").json())
    timeline = LabelTimeline(read_labels(given.truth))
    with sync_playwright() as playwright:
        page = playwright.chromium.launch(executable_path=given.chromium, args=["--no-sandbox"]).new_page(
            viewport={"width": 1600, "height": 1000}
        )
        page.goto(f"{given.url}/sign-in#token={given.token}")
        page.wait_for_url("**/jobs")
        for way in ("proposals", "nothing"):
            name = f"benchmark-{way}-{int(time.time())}"
            page.evaluate("name => { localStorage['wibam-label-set'] = name; }", name)
            seconds, actions, overlaps, before = [], [], [], []
            for suggestion in http.get("/labels/suggestions", params={"count": given.instants}).json():
                time_ns = suggestion["time_ns"]
                truth = timeline.at(time_ns)
                assert truth is not None, "the truth holds the instants"
                truths, best = largest(truth, cameras)
                page.goto(f"{given.url}/jobs/{given.job}/labelling?time_ns={time_ns}")
                page.get_by_text("not labelled yet").wait_for()
                page.evaluate("document.querySelector('.screens').scrollIntoView(); window.scrollBy(0, -110)")
                address = f"/labels/instants/{time_ns}"
                script = Script(
                    page, lambda at=address, of=name: http.get(at, params={"set": of}).json()["labels"], cameras
                )
                start = time.monotonic()
                ids = (script.from_proposals if way == "proposals" else script.from_nothing)(truths, best)
                script.press("Enter")
                seconds.append(time.monotonic() - start)
                actions.append(script.actions)
                if way == "proposals":
                    proposed = np.array([one["box"] for one in http.get(f"{address}/proposal").json()])
                    before.append(float(bev_iou(truths, proposed).max(axis=1).mean()))
                found = script.boxes()
                overlaps.append(float(bev_iou_paired(np.array([found[i] for i in ids]), truths).mean()))
            ratio = f", {statistics.mean(before):.3f} before" if before else ""
            print(
                f"from {way}: {len(seconds)} instants with {VEHICLES} vehicles, {max(seconds):.1f} s and "
                f"{max(actions)} actions at most, "
                f"mean BEV IoU {statistics.mean(overlaps):.3f}{ratio}"
            )
        drags = page.evaluate("performance.getEntriesByName('drag').map((one) => one.duration)")
        print(f"script's work for a drag step over {len(cameras)} views: p95 {np.percentile(drags, 95):.1f} ms")


if __name__ == "__main__":
    main()
