"""The before/after table and what its tests say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from wibam_core.documents.base import MeanSd
from wibam_core.documents.metrics import DetectorFigures, Metrics, Significance
from wibam_core.report.advice import SIGNIFICANT
from wibam_core.report.words import NONE, number, signed

#: Means and standard deviations published for the method, on the authors' own test set.
PUBLISHED: Mapping[str, tuple[MeanSd, MeanSd]] = {
    "bev_iou": (MeanSd(mean=0.33, sd=0.25), MeanSd(mean=0.64, sd=0.13)),
    "iou_3d": (MeanSd(mean=0.25, sd=0.18), MeanSd(mean=0.48, sd=0.09)),
    "ate_m": (MeanSd(mean=1.51, sd=0.97), MeanSd(mean=0.43, sd=0.43)),
    "ase": (MeanSd(mean=0.12, sd=0.06), MeanSd(mean=0.23, sd=0.07)),
    "aoe_deg": (MeanSd(mean=5.67, sd=5.47), MeanSd(mean=4.69, sd=2.91)),
}
#: Networks in the order of the columns, by their names in the metrics.
NETWORKS = {
    "baseline_depth": "baseline (depth)",
    "baseline_plane": "baseline (plane)",
    "baseline": "baseline",
    "finetuned": "fine-tuned",
}


@dataclass(frozen=True)
class Cell:
    """A figure, and beneath it its spread."""

    value: str
    spread: str = ""


_Cells = tuple[Cell, ...]


@dataclass(frozen=True)
class ResultRow:
    """One metric, with a cell for each of `compared`.

    ``verdict`` is "better", "worse" or "" where the change may be chance.
    """

    name: str
    correct: _Cells
    change: Cell
    verdict: str
    paper_compat: _Cells
    published: tuple[Cell, Cell]


def compared(metrics: Metrics) -> dict[str, str]:
    """Those of `NETWORKS` that were measured against labels."""
    return {name: title for name, title in NETWORKS.items() if getattr(metrics, name) is not None}


def result_rows(metrics: Metrics) -> tuple[ResultRow, ...]:
    """The before/after table: empty without labels."""
    if metrics.baseline is None or metrics.finetuned is None:
        return ()
    networks = tuple(getattr(metrics, name) for name in compared(metrics))
    compat = tuple((metrics.paper_compat or {}).get(name) for name in compared(metrics))
    tests = metrics.significance or {}
    measured = [
        _metric_row(name, title, digits, networks, compat, tests.get(name))
        for name, title, digits in (
            ("bev_iou", "BEV IoU", 2),
            ("iou_3d", "3D IoU", 2),
            ("ate_m", "ATE (m)", 2),
            ("ase", "ASE", 3),
            ("aoe_deg", "AOE (°)", 1),
            ("recall", "recall", 2),
            ("bev_iou_misses_zero", "BEV IoU, misses as zero", 2),
            ("iou_3d_misses_zero", "3D IoU, misses as zero", 2),
        )
    ]
    counted = [
        ResultRow(title, _counts(networks, name), Cell(""), "", _counts(compat, name), (Cell(""), Cell("")))
        for name, title in (("matched", "matched"), ("missed", "missed"), ("false_positives", "false positives"))
    ]
    aliased = ResultRow(
        "AOE of 150° and more", _alias_shares(networks), Cell(""), "", _alias_shares(compat), (Cell(""), Cell(""))
    )
    return (*measured, aliased, *counted)


def _metric_row(
    name: str,
    title: str,
    digits: int,
    networks: tuple[DetectorFigures | None, ...],
    compat: tuple[DetectorFigures | None, ...],
    test: Significance | None,
) -> ResultRow:
    change, verdict = _change(name, digits, test)
    before, after = (_cell(value, digits) for value in PUBLISHED.get(name, (None, None)))
    return ResultRow(
        title, _cells(networks, name, digits), change, verdict, _cells(compat, name, digits), (before, after)
    )


def _cell(value: MeanSd | None, digits: int) -> Cell:
    if value is None:
        return Cell("")
    return Cell(number(value.mean, digits), "" if value.sd is None else f"± {value.sd:.{digits}f}")


def _cells(networks: tuple[DetectorFigures | None, ...], name: str, digits: int) -> _Cells:
    return tuple(_cell(getattr(one, name, MeanSd()), digits) for one in networks)


def _alias_shares(networks: tuple[DetectorFigures | None, ...]) -> _Cells:
    return tuple(
        Cell(NONE if figures is None or figures.alias_share is None else f"{100 * figures.alias_share:.1f} %")
        for figures in networks
    )


def _counts(networks: tuple[DetectorFigures | None, ...], name: str) -> _Cells:
    return tuple(_count(None if one is None else getattr(one, name)) for one in networks)


def _count(value: int | None) -> Cell:
    return Cell(NONE if value is None else f"{value}")


def _change(name: str, digits: int, test: Significance | None) -> tuple[Cell, str]:
    if test is None or test.difference is None:
        return Cell(""), ""
    p = test.p_bootstrap
    mark = "" if p is None or p >= 0.05 else " **" if p < SIGNIFICANT else " *"
    higher_is_better = name in ("bev_iou", "iou_3d")
    verdict = "" if not mark else "better" if (test.difference > 0) == higher_is_better else "worse"
    low, high = (None if end is None else signed(end, digits) for end in (test.low, test.high))
    ends = "" if low is None or high is None else f"{low} to {high}"
    if test.is_of_too_few:
        ends = too_few(test)
    return Cell(signed(test.difference, digits) + mark, ends), verdict


def too_few(test: Significance) -> str:
    """What stands in place of an interval where there are too few vehicles for one."""
    count = test.vehicles or 0
    return f"{count} vehicle{'' if count == 1 else 's'}: too few"


def z_tests(metrics: Metrics) -> str:
    """Which differences are significant by the paper's own test, and which are not."""
    tests = metrics.significance or {}
    if not tests:
        return ""
    real = [_title(name) for name, test in tests.items() if test.p_z is not None and test.p_z < SIGNIFICANT]
    chance = [_title(name) for name in tests if _title(name) not in real]
    by = "By the paper's Z-test over single boxes"
    if not real:
        return f"{by} no difference is significant at 0.01."
    if not chance:
        return f"{by} all differences are significant at 0.01: {_listed(real)}."
    plural, verb = ("s", "are") if len(real) > 1 else ("", "is")
    others, other_verb = ("those", "are") if len(chance) > 1 else ("that", "is")
    return (
        f"{by} the difference{plural} in {_listed(real)} {verb} significant at 0.01; "
        f"{others} in {_listed(chance)} {other_verb} not."
    )


def _listed(names: list[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _title(name: str) -> str:
    return {"bev_iou": "BEV IoU", "iou_3d": "3D IoU", "ate_m": "ATE", "ase": "ASE", "aoe_deg": "AOE"}.get(name, name)
