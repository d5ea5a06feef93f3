import numpy as np
import pytest

from wibam_core.pretraining.validation import ViewResult, measure

CAR = np.array([[10.0, 0.0, 0.75, 4.4, 1.8, 1.5, 0.0]])


def test_figures_of_a_known_case() -> None:
    moved = CAR + [[0.3, 0.4, 0, 0, 0, 0, np.radians(10)]]
    far = CAR + [[30.0, 0, 0, 0, 0, 0, 0]]
    optional = CAR + [[0, 20.0, 0, 0, 0, 0, 0]]
    figures = measure(
        [
            ViewResult(np.concatenate([moved, far, optional]), CAR, optional),
            ViewResult(np.zeros((0, 7)), CAR, np.zeros((0, 7))),
        ]
    )
    assert figures["ate_m"] == pytest.approx(0.5)
    assert figures["aoe_deg"] == pytest.approx(10.0)
    assert figures["ase"] == pytest.approx(0.0, abs=1e-9)
    assert figures["recall"] == 0.5
    assert figures["precision"] == 0.5  # the far one is false, the optional one does not count
    assert 0 < figures["bev_iou"] < 1
    assert figures["iou_3d"] == pytest.approx(figures["bev_iou"]), "equally high, and at one height"


def test_nothing_found_gives_no_mean_errors() -> None:
    figures = measure([ViewResult(np.zeros((0, 7)), CAR, np.zeros((0, 7)))])
    assert figures == {"recall": 0.0, "precision": 0.0, "vehicles": 1}
