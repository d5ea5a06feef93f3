"""What the benchmarks of learning make of their rows; nothing is recorded or trained here."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from benchmarks import learning
from benchmarks.learning_options import command_of, site_parser
from benchmarks.learning_report import (
    as_published,
    by_distance,
    document,
    draw,
    metrics_figure,
    options,
    ratios,
    table,
    verdicts,
)
from benchmarks.learning_rows import RowFile, Run, code_version, joined, mean_of, read_rows, versions, write_rows
from tests.unit.benchmarks.learning_figures import arguments, figures
from wibam_core.cli.run import parse_options
from wibam_core.config import FinetuneConfig, PipelineConfig


def rows() -> list[dict[str, Any]]:
    of = {"baseline": 0.4, "lifted": 0.6, "truth": 0.8}
    return [
        {
            "run": {"site": site, "seed": 0, "method": method, "seconds": 90.0, "width_px": 640},
            **figures(bev + site / 100),
        }
        for site in (1, 2)
        for method, bev in of.items()
    ]


def test_rows_are_computed_once(tmp_path: Path) -> None:
    computed = []

    def compute(run: Run) -> dict[str, Any]:
        computed.append(run["site"])
        return {"value": run["site"]}

    def rows_of(limit: int, *, fresh: bool = False, **more: Any) -> list[dict[str, Any]]:
        runs = [{"site": k, "options": (1, 2), **more} for k in range(limit)]
        return list(RowFile(tmp_path / "rows.json", fresh=fresh).rows(runs, compute))

    first = rows_of(2)
    again = rows_of(3)
    assert computed == [0, 1, 2]
    assert again[:2] == first
    rows_of(1, steps=9)  # other options
    rows_of(1, fresh=True)
    assert computed == [0, 1, 2, 0, 0]


def test_a_killed_run_keeps_what_it_made(tmp_path: Path) -> None:
    def compute(run: Run) -> dict[str, Any]:
        if run["site"] == 2:
            raise KeyboardInterrupt
        return {"a": 1}

    with pytest.raises(KeyboardInterrupt):
        list(RowFile(tmp_path / "rows.json").rows([{"site": 1}, {"site": 2}], compute))
    assert RowFile(tmp_path / "rows.json").find({"site": 1}) == {"run": {"site": 1}, "code": code_version(), "a": 1}
    assert RowFile(tmp_path / "rows.json").find({"site": 2}) is None


def test_rows_that_do_not_say_what_was_run_are_forgotten(tmp_path: Path) -> None:
    (tmp_path / "rows.json").write_text('[{"site": 501, "method": "lifted"}]')
    assert RowFile(tmp_path / "rows.json").find({"site": 501}) is None


def test_rows_of_other_code_are_made_again_unless_they_are_kept(tmp_path: Path) -> None:
    path, run = tmp_path / "rows.json", {"site": 1}
    write_rows(path, [{"run": run, "a": 0}, {"run": {"site": 2}, "code": "old", "a": 0}])
    assert RowFile(path, code="new").find(run) is None  # it does not say which code made it
    assert RowFile(path, code="new").find({"site": 2}) is None
    assert RowFile(path, code="old").find({"site": 2}) is not None
    assert list(RowFile(path, keep=True, code="new").rows([run], lambda _: {"a": 1})) == [{"run": run, "a": 0}]
    assert list(RowFile(path, code="new").rows([run], lambda _: {"a": 1})) == [{"run": run, "code": "new", "a": 1}]
    assert [row["a"] for row in read_rows(path)] == [0, 1]  # the row of the other run stays, that of this run gives way


def test_the_version_of_the_code_is_that_of_every_stage_that_makes_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    before = code_version()
    assert before == code_version() and len(before) == 10
    for changed in ("detect", "lift", "finetune", "evaluate"):
        digest = "wibam_core.stages.graph.code_digest"
        monkeypatch.setattr(digest, lambda stage, *of, c=changed: "x" if stage == c else "y")
        found = code_version()
        monkeypatch.setattr(digest, lambda stage, *of: "y")
        assert found != code_version()


def test_of_equal_runs_in_several_files_the_first_counts(tmp_path: Path) -> None:
    write_rows(tmp_path / "a.json", [{"run": {"site": 1}, "a": 1}])
    write_rows(tmp_path / "b.json", [{"run": {"site": 1}, "code": "x", "a": 2}, {"run": {"site": 2}, "a": 3}])
    assert [row["a"] for row in joined([tmp_path / "a.json", tmp_path / "b.json"])] == [1, 3]
    assert [row["a"] for row in joined([tmp_path / "b.json", tmp_path / "a.json"])] == [2, 3]


def test_the_document_says_when_the_code_changed_between_rows() -> None:
    assert versions(rows()) == "" == versions([row | {"code": "a1"} for row in rows()])
    mixed = [rows()[0], *(row | {"code": "a1"} for row in rows()[1:])]
    assert versions(mixed).endswith("not recorded (1), a1 (5).")
    assert versions(mixed) in document(mixed, "command")
    assert "several versions" not in document(rows(), "command")


def run_of(site: int, method: str, seed: int = 0, steps: int = 5) -> dict[str, Any]:
    finetune = learning.options_of(method, seed, steps)
    recording = {"seconds": 120.0, "density": 1.2, "width_px": 640}
    return {"site": site, "seed": seed, "method": method, **recording, "finetune": finetune}


def test_commands_make_the_rows_that_they_stand_for(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = [run_of(s, m) for s in (501, 502) for m in ("lifted", "baseline")]
    runs += [run_of(501, "lifted", seed=1), run_of(503, "labels")]
    commands = learning.commands_of([{"run": run} for run in runs])
    assert commands[0] == (
        "python -m benchmarks.learning --sites 501 502 --seeds 0 --seconds 120 --density 1.2 --width-px 640 "
        "--steps 5 --methods baseline lifted"
    )
    assert len(commands) == 3 and "--steps" not in commands[-1]
    typed = []
    for command in commands:
        monkeypatch.setattr(sys, "argv", command.split()[2:])
        typed += list(learning.runs_of(learning.parse()))
    assert sorted(map(str, typed)) == sorted(map(str, runs))


def test_runs_of_a_users_network_know_it_by_its_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    def typed(command: str) -> list[Run]:
        monkeypatch.setattr(sys, "argv", command.split()[2:])
        return list(learning.runs_of(learning.parse()))

    command = "python -m benchmarks.learning --sites 501 --seeds 0 --seconds 90 --steps 5 --network network.safetensors"
    Path("network.safetensors").write_bytes(b"one")
    first = typed(command)
    Path("network.safetensors").write_bytes(b"two")
    assert {run["method"] for run in first} == set(learning.DEFAULT_METHODS)
    assert all(run["finetune"]["network"] == "custom" for run in first if run["finetune"] is not None)
    for run in first:
        FinetuneConfig(**(run["finetune"] or {}))
    assert not any(run in first for run in typed(command))
    again = typed(command)
    written = learning.commands_of([{"run": run} for run in again])
    assert sorted(map(str, (run for one in written for run in typed(one)))) == sorted(map(str, again))


def test_rows_of_files_are_drawn_without_running_anything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lifted = {"run": run_of(501, "lifted"), **figures(0.6)}  # as rows were that did not say which code made them,
    del lifted["run"]["width_px"]  # nor how wide the recordings were
    write_rows(tmp_path / "a.json", [lifted, {"run": run_of(501, "baseline"), "code": "x", **figures(0.4)}])
    write_rows(tmp_path / "b.json", [{**lifted, "bev_iou": None}, {"run": run_of(502, "lifted"), **figures(0.7)}])
    inputs = [str(tmp_path / name) for name in ("a.json", "b.json")]
    monkeypatch.setattr(sys, "argv", ["learning", "--draw", *inputs, "--out", str(tmp_path / "out")])
    learning.main()
    written = json.loads((tmp_path / "out" / "learning.json").read_text())
    assert [(row["run"]["site"], row["run"]["method"]) for row in written] == [
        (501, "baseline"),
        (501, "lifted"),
        (502, "lifted"),
    ]
    assert written[1] == lifted
    text = (tmp_path / "out" / "learning.md").read_text()
    assert "    python -m benchmarks.learning --sites 501 --seeds 0 --seconds 120" in text
    assert "--width-px 640" in text and "120 s each, 640 px wide" in text
    assert "| lifted | plane | 2 | 0.650" in text and "x (1), not recorded (2)" in text
    assert (tmp_path / "out" / "learning.png").is_file()
    monkeypatch.setattr(sys, "argv", [*sys.argv, "--name", "other"])
    learning.main()
    assert json.loads((tmp_path / "out" / "other.json").read_text()) == written
    text = (tmp_path / "out" / "other.md").read_text()
    assert "--methods baseline lifted --name other" in text and "![metrics](other.png)" in text
    assert (tmp_path / "out" / "other.png").is_file() and (tmp_path / "out" / "other-distance.png").is_file()
    (tmp_path / "b.json").write_text('[{"site": 501}]')
    with pytest.raises(SystemExit, match=r"b\.json"):
        learning.main()


def test_commands_are_typed_as_they_are_parsed() -> None:
    typed = command_of("x", poses_deg=[0.1, 1.0], draws=3, train=True, fresh=False, steps=None)
    assert typed == "python -m benchmarks.x --poses-deg 0.1 1 --draws 3 --train"
    shared = site_parser("about", sites=[1], seconds=9.0).parse_args(["--sites", "2", "3"])
    assert (shared.sites, shared.seconds, shared.keep, shared.fresh) == ([2, 3], 9.0, False, False)


def test_methods_say_how_their_fits_are_made_and_a_job_is_asked() -> None:
    methods = ["lifted", "lifted_track", "labels_track", "paper_code"]
    runs = list(learning.runs_of(arguments(sites=[501], seeds=[0], methods=methods)))
    assert [run.get("lift") for run in runs] == [None, {"learn_templates": False}, {"learn_templates": False}, None]
    asked = options([{"run": run} for run in runs])
    assert "| lifted |" not in asked
    assert "| lifted_track | `--set lift.learn_templates=false` |" in asked.splitlines()
    own_view = "--set finetune.method=paper --set finetune.own_view=true --set finetune.box_heads=true"
    assert f"| paper_code | `{own_view} --set finetune.decode=depth` |" in asked.splitlines()
    for line in asked.splitlines()[2:]:
        PipelineConfig.parse(parse_options(line.split("`")[1].split()[1::2]))


def test_one_network_serves_all_ways_to_place_boxes_that_it_is_trained_alike_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def trained(site: Any, options: Run, lift: Run | None = None) -> tuple[Any, Run, Run | None]:
        return site, options, lift

    monkeypatch.setattr(learning, "finetuned_by_stage", trained)
    monkeypatch.setattr(learning, "placed", lambda site, network, decode: (network, decode))
    site: Any = "site"
    usual = learning.options_of("lifted", 0, 5)
    for decode in ("ground", "fitted"):
        found: Any = learning.trained_by(site, f"lifted_{decode}", learning.options_of(f"lifted_{decode}", 0, 5))
        assert found == ((site, usual, None), decode)
    for method in ("lifted_plane", "paper_code"):
        own: Any = learning.trained_by(site, method, learning.options_of(method, 0, 5))
        assert own == (site, learning.options_of(method, 0, 5), None)


def test_every_method_has_options_that_exist() -> None:
    for method in learning.METHODS:
        asked = learning.options_of(method, seed=3, steps=7)
        if asked is not None:
            assert FinetuneConfig(**asked).steps == 7
    assert learning.options_of("labels", 0, 1) is None
    assert set(learning.DEFAULT_METHODS) <= set(learning.METHODS)


def test_every_run_is_another() -> None:
    runs = list(learning.runs_of(arguments()))
    assert len(runs) == 2 * 2 * 2
    assert len({str(run) for run in runs}) == len(runs)


def test_the_table_has_means_and_spreads_over_runs() -> None:
    lines = table(rows()).splitlines()
    assert lines[2].startswith("| baseline | plane | 2 | 0.415 ± 0.007 |")
    assert len({line.count("|") for line in lines}) == 1


def test_ratios_are_taken_run_by_run() -> None:
    line = next(line for line in ratios(rows()).splitlines() if line.startswith("| lifted"))
    assert line.startswith(f"| lifted | {(0.61 / 0.81 + 0.62 / 0.82) / 2:.2f} ± 0.00 |")
    assert line.endswith("| 0.50 ± 0.00 |")
    without = [row for row in rows() if row["run"]["method"] != "truth"]
    assert ratios(without) == ""
    assert "Relative to" in document(rows(), "command") and "Relative to" not in document(without, "command")


def test_verdicts_count_significant_runs() -> None:
    some = [
        *rows(),
        {"run": {"site": 3, "seed": 0, "method": "lifted", "seconds": 90.0, "width_px": 640}, **figures(0.3, -0.1)},
    ]
    assert "| lifted | 3 | 2 | 1 | 0 |" in verdicts(some).splitlines()
    assert not any(line.startswith("| baseline") for line in verdicts(some).splitlines())


def test_the_document_says_which_sites_were_looked_at(tmp_path: Path) -> None:
    unseen = document(rows(), "command")
    assert "Not looked at before: 1, 2." in unseen and "flatter" not in unseen
    later = [row | {"run": {**row["run"], "site": 13}} for row in rows()]
    text = document(later, "command")
    assert "Chosen on, so that its figures flatter: 13. " in text and "(`benchmarks/looks.json`)" in text
    assert "    command" in text and by_distance(later) in text and "0–10 m" in text
    draw(later, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"learning.png", "learning-distance.png"}


def test_what_the_paper_reports_stands_only_beside_what_is_counted_as_it_counts() -> None:
    def lines(figure: Figure) -> dict[str, list[float]]:
        """Title of a panel -> where its level lines are."""
        found = {}
        for axes in figure.axes:
            levels = [
                float(np.ravel(line.get_xdata())[0]) for line in axes.lines if line.get_linestyle() in (":", "--")
            ]
            found[axes.get_title(loc="left") or axes.get_title()] = levels
        return found

    assert not any(lines(metrics_figure(rows())).values())
    counted = [row | {"paper_compat": figures(0.2)} for row in rows()]
    found = lines(metrics_figure(counted))
    assert {title for title, at in found.items() if at} == {title for title in found if title.endswith("paper_compat")}
    assert len(found) == 10 and {0.12, 0.23} <= set(found["ASE, paper_compat"])


def test_a_figure_is_a_number_or_a_mean() -> None:
    assert (mean_of({"a": 2}, "a"), mean_of({"a": {"mean": 3}}, "a"), mean_of({}, "a")) == (2, 3, None)


def test_the_document_says_first_what_its_figures_cannot_show() -> None:
    of = {"baseline": (0.40, 0.50, 0.45), "lifted": (0.61, 0.69, 0.65), "baseline_plane": (0.3, 0.3, 0.3)}
    some = [
        {"run": {"site": 501 + at, "seed": 0, "method": method, "seconds": 90.0}, **figures(bev)}
        for method, values in of.items()
        for at, bev in enumerate(values)
    ]
    some.append({"run": {"site": 502, "seed": 0, "method": "paper", "seconds": 90.0}, **figures(0.35)})
    text = document(some, "command")
    assert text.index("Looked at before: 501, 502, 503") < text.index("| method |")
    # gains of 0.21, 0.19 and 0.20: a mean of 0.2, an s.d. of 0.01, and Student's t is 4.303 at 97.5 % and 2 degrees
    assert f"BEV IoU +0.200 ± {4.303 * 0.01 / 3**0.5:.3f}" in text
    assert "`paper` ran once (`lifted`: 3 times)" in text and "BEV IoU 0.300 → 0.350" in text
    assert "4 of 20 at site 502 and 5 of 30 at site 503" in text

    text = document(rows(), "command")
    assert "no fair trial" not in text and "Looked at before" not in text and "at site 502" not in text
    one = document([row for row in rows() if row["run"]["site"] == 1], "command")
    assert "**One site**" in one and "t-intervals" not in one


def test_what_cannot_be_told_from_chance_is_said_to_include_zero() -> None:
    of = {"baseline": (0.4, 0.4, 0.4), "lifted": (0.3, 0.5, 0.7)}
    some = [
        {"run": {"site": at, "seed": 0, "method": method, "seconds": 90.0}, **figures(bev)}
        for method, values in of.items()
        for at, bev in enumerate(values)
    ]
    assert "include 0: BEV IoU +0.100 ± 0.497" in document(some, "command")


def test_means_as_published_stand_beside_the_papers_own() -> None:
    compat = {name: {"mean": 0.2, "sd": 0.1} for name in ("bev_iou", "iou_3d", "ate_m", "ase", "aoe_deg")}
    lines = as_published([row | {"paper_compat": compat} for row in rows()]).splitlines()
    assert lines[2] == "| baseline | 2 | 0.200 ± 0.000 | 0.200 ± 0.000 | 0.200 ± 0.000 | 0.200 ± 0.000 | 0.2 ± 0.0 |"
    assert lines[-1] == "| the paper, after | – | 0.64 | 0.48 | 0.43 | 0.23 | 4.69 |"  # its Table 1
    assert as_published(rows()) == ""
