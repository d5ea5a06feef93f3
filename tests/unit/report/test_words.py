"""Sentences, tables and the summary: they must say what the figures say."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from rich.console import Console

from tests.builders import AMBIGUOUS
from tests.unit.report.documents import conflicts_json, metrics_json
from tests.unit.report.scenes import crossing_traffic
from wibam_core.cli.tables import before_after_table, print_tables
from wibam_core.documents.conflicts import Conflicts
from wibam_core.documents.metrics import Metrics
from wibam_core.report.advice import advice
from wibam_core.report.page import conflict_cells
from wibam_core.report.results import compared, result_rows, z_tests
from wibam_core.report.summary import summary
from wibam_core.report.words import interval


def changed(**significance: dict[str, float]) -> Metrics:
    document = metrics_json()
    for name, values in significance.items():
        document["significance"][name] |= values
    return Metrics.model_validate(document)


def test_advice_for_a_real_gain():
    text = " ".join(advice(Metrics.model_validate(metrics_json())))
    assert "lifted BEV IoU from 0.46 to 0.72" in text
    assert "from 0.95 m to 0.36 m" in text and "from 55 % to 94 %" in text
    assert "use the fine-tuned weights" in text


def test_road_users_that_no_network_knows_are_said_to_be_missing() -> None:
    for labels in (True, False):
        document = metrics_json(labels=labels)
        assert "no track: motorcycle, bicycle, pedestrian." in advice(Metrics.model_validate(document))[-1]
        assert "do not know" not in " ".join(advice(Metrics.model_validate({**document, "not_asked_for": []})))


def test_advice_for_chance_is_to_record_longer():
    text = " ".join(advice(changed(bev_iou={"p_bootstrap": 0.2})))
    assert "may be chance" in text and "use the fine-tuned weights at" not in text


@pytest.mark.parametrize(("vehicles", "words"), [(1, "1 vehicle: too few"), (5, "5 vehicles: too few")])
def test_of_a_few_vehicles_nothing_is_called_sure(vehicles: int, words: str) -> None:
    unsure = {"low": None, "high": None, "p_bootstrap": None, "vehicles": vehicles}
    metrics = changed(**dict.fromkeys(("bev_iou", "iou_3d", "ate_m", "ase", "aoe_deg"), unsure))
    text = " ".join(advice(metrics))
    assert words in text.replace("different ", "") and "more than chance" not in text
    row = result_rows(metrics)[0]
    assert row.change.value == "+0.26" and row.verdict == ""
    assert row.change.spread == words
    buffer = io.StringIO()
    Console(file=buffer, width=200).print(before_after_table(metrics))
    shown = buffer.getvalue()
    assert "0.72 (0.15)" in shown and "*" not in shown and "too few different vehicles" in shown


def test_advice_against_worse_weights():
    assert "do not use it" in " ".join(advice(changed(bev_iou={"difference": -0.1})))


def test_advice_warns_of_sizes_that_shrank():
    text = " ".join(advice(changed(ase={"difference": 0.1, "p_bootstrap": 0.001})))
    assert "do not take lengths and widths" in text
    assert "lengths" not in " ".join(advice(changed(ase={"difference": 0.1, "p_bootstrap": 0.5})))


@pytest.mark.parametrize(
    ("metric", "words"),
    [("ate_m", "Positions got worse"), ("ase", "Sizes got worse"), ("aoe_deg", "Headings got worse")],
)
def test_advice_names_an_error_that_grew_by_more_than_chance(metric, words):
    assert words in " ".join(advice(changed(**{metric: {"difference": 4.0, "p_bootstrap": 0.001}})))
    for no_loss in (
        {"difference": -4.0, "p_bootstrap": 0.001},
        {"difference": 4.0, "p_bootstrap": 0.2},
        {"difference": 4.0, "p_bootstrap": None},
    ):
        assert words not in " ".join(advice(changed(**{metric: no_loss})))


@pytest.mark.parametrize(
    ("recall", "false_positives", "words"),
    [
        (0.49, 14, ["Fewer vehicles are found (recall 55 % to 49 %)"]),
        (0.54, 21, []),
        (0.6, 60, ["There are more false positives (14 to 60)"]),
        (0.3, 60, ["Fewer vehicles are found", "more false positives"]),
    ],
)
def test_advice_names_vehicles_lost_and_made_up(recall, false_positives, words):
    document = metrics_json()
    document["finetuned"] |= {"recall": {"mean": recall, "sd": 0.2}, "false_positives": false_positives}
    text = " ".join(advice(Metrics.model_validate(document)))
    assert all(word in text for word in words)
    assert ("Fewer vehicles" in text, "false positives" in text) == (recall < 0.5, false_positives > 21)


def test_z_tests_name_what_is_significant():
    none = {name: {"p_z": 0.3} for name in ("bev_iou", "iou_3d", "ate_m", "ase", "aoe_deg")}
    real = {"p_z": 1e-6}
    assert "no difference is significant" in z_tests(changed(**none))
    assert z_tests(changed(**{**none, "aoe_deg": real})).endswith(
        "the difference in AOE is significant at 0.01; those in BEV IoU, 3D IoU, ATE and ASE are not."
    )
    assert z_tests(changed(ase={"p_z": None})).endswith(
        "the differences in BEV IoU, 3D IoU, ATE and AOE are significant at 0.01; that in ASE is not."
    )
    assert "all differences are significant at 0.01: BEV IoU, 3D IoU, ATE, ASE and AOE." in z_tests(changed())


@pytest.mark.parametrize(
    ("ttc_s", "needed_mps2", "cell"), [(1.27, 3.4, "3.4"), (0.4, 10.0, "10.0"), (0.001, 2683.4, "> 10"), (None, 0, "–")]
)
def test_braking_beyond_what_tyres_can_do_has_no_figure(ttc_s, needed_mps2, cell):
    document = conflicts_json()
    document["conflicts"][0] |= {"ttc_s": ttc_s, "deceleration_mps2": needed_mps2}
    (row,) = Conflicts.model_validate(document).conflicts
    assert conflict_cells(1, row)[-3:] == (cell, "10.6", "–")


def test_advice_sees_a_gain_that_loses_vehicles():
    document = metrics_json()
    document["finetuned"]["bev_iou_misses_zero"] = {"mean": 0.1, "sd": 0.1}
    assert "fewer vehicles are found" in " ".join(advice(Metrics.model_validate(document)))


def test_advice_without_labels_claims_no_accuracy():
    text = " ".join(advice(Metrics.model_validate(metrics_json(labels=False))))
    assert "no labels" in text and "0.42 before (900 pairs) and 0.71 after" in text
    assert text.index("0.30 before and 0.90 after") < text.index("0.42 before")
    assert "use the fine-tuned weights" not in text


def test_advice_without_matches_compares_nothing():
    document = metrics_json()
    document["baseline"] |= {"matched": 0, "bev_iou": {"mean": None, "sd": None}}
    for test in document["significance"].values():
        test |= {"difference": None, "p_bootstrap": None}
    text = " ".join(advice(Metrics.model_validate(document)))
    assert "nothing to compare" in text and "None" not in text


def test_results_mark_better_and_worse_by_the_sense_of_each_metric():
    rows = {row.name: row for row in result_rows(Metrics.model_validate(metrics_json()))}
    assert rows["BEV IoU"].verdict == "better" and rows["BEV IoU"].change.value == "+0.26 **"
    assert rows["ATE (m)"].verdict == "better" and rows["ATE (m)"].change.value == "−0.59 **"
    assert rows["BEV IoU"].published[1].value == "0.64"
    assert rows["missed"].paper_compat[-1].value == "–" and rows["missed"].correct[-1].value == "33"
    assert [cell.value for cell in rows["BEV IoU"].correct] == ["0.06", "0.38", "0.46", "0.72"]
    assert result_rows(Metrics.model_validate(metrics_json(labels=False))) == ()


def test_only_baselines_that_were_measured_are_compared():
    document = metrics_json()
    del document["baseline_plane"], document["paper_compat"]["baseline_plane"]
    metrics = Metrics.model_validate(document)
    assert list(compared(metrics)) == ["baseline_depth", "baseline", "finetuned"]
    assert {len(row.correct) for row in result_rows(metrics)} == {len(row.paper_compat) for row in result_rows(metrics)}
    assert [cell.value for cell in result_rows(metrics)[0].correct] == ["0.06", "0.46", "0.72"]


def test_interval_without_an_upper_end():
    assert interval(1.5, (1.0, None)) == "1.50 [1.00, ∞]"
    assert interval(None, (None, None)) == "–"


@pytest.mark.parametrize("labels", [True, False])
def test_summary_has_the_promised_keys(labels):
    paths = {"weights": Path("w"), "tracks": Path("t"), "report": Path("r")}
    metrics = Metrics.model_validate(metrics_json(labels=labels))
    found = json.loads(summary(metrics, {"sync": 1.23456}, [AMBIGUOUS], 6, 1, paths).model_dump_json())
    assert found["tracks"] == 6 and found["conflicts"] == 1 and found["seconds"] == {"sync": 1.235}
    assert found["warnings"] == [AMBIGUOUS.model_dump()]
    assert found["paths"] == {"weights": "w", "tracks": "t", "report": "r"}
    for name in ("baseline", "finetuned"):
        if not labels:
            assert found[name] is None
            continue
        assert set(found[name]) == {"bev_iou", "iou_3d", "ate_m", "ase", "aoe_deg", "recall", "matched", "missed"}
        assert set(found[name]["recall"]) == {"mean", "sd"}
    if labels:
        assert found["finetuned"]["matched"] == 512 and found["finetuned"]["missed"] == 33


@pytest.mark.parametrize("labels", [True, False])
def test_terminal_tables(labels):
    out = io.StringIO()
    console = Console(file=out, width=200, no_color=True)
    metrics, conflicts = metrics_json(labels=labels), conflicts_json()
    print_tables(console, Metrics.model_validate(metrics), crossing_traffic(), Conflicts.model_validate(conflicts))
    text = out.getvalue()
    assert ("0.72 (0.15)**" in text) == labels
    assert "Tracks: 5 of 6" in text and "Conflicts: 1 of 1" in text and "1.3 (0.9–1.8)" in text
    assert ("paper_compat" in text) == labels
    assert text.count("AOE of 150° and more") == 2 * labels
    assert "None" not in text
