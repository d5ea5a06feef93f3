"""What the figures mean for the person who has to decide, in plain sentences."""

from __future__ import annotations

from wibam_core.documents.metrics import DetectorFigures, Metrics, Significance
from wibam_core.report.words import percent

#: Differences are called real below this p (bootstrap over vehicles).
SIGNIFICANT = 0.01
#: Fewer matched sightings than this are too few to say much.
_FEW_MATCHES = 50
#: Recall has no test of its own: a loss of this share of the labelled vehicles is worth a warning.
_CLEAR_LOSS = 0.05
#: False positives are clearly more if two Poisson counts would differ so only once in a hundred times, and by this.
_CLEAR_Z, _CLEAR_RATIO = 2.58, 1.25


def advice(metrics: Metrics) -> list[str]:
    """A few sentences: what changed, whether that is more than chance, what to do."""
    if metrics.baseline is None or metrics.finetuned is None:
        return [*_without_labels(metrics), *_not_asked_for(metrics)]
    return [
        _what_changed(metrics.baseline, metrics.finetuned),
        _verdict(metrics.baseline, metrics.finetuned, (metrics.significance or {}).get("bev_iou")),
        *_reservations(metrics.baseline, metrics.finetuned, metrics.significance or {}),
        *_not_asked_for(metrics),
    ]


def _not_asked_for(metrics: Metrics) -> list[str]:
    if not metrics.not_asked_for:
        return []
    return [
        f"The networks do not know these road users, which are in no figure and no track: "
        f"{', '.join(metrics.not_asked_for)}."
    ]


def _what_changed(before: DetectorFigures, after: DetectorFigures) -> str:
    if before.matched == 0 or after.matched == 0:
        return (
            f"The baseline found {before.matched} labelled vehicles and the fine-tuned network {after.matched}: "
            "there is nothing to compare."
        )
    return (
        f"Fine-tuning {_moved(before.bev_iou.mean, after.bev_iou.mean)}; the position error went from "
        f"{_two(before.ate_m.mean)} m to {_two(after.ate_m.mean)} m, and the share of vehicles found from "
        f"{percent(before.recall.mean)} to {percent(after.recall.mean)}."
    )


def _verdict(before: DetectorFigures, after: DetectorFigures, test: Significance | None) -> str:
    first, second = before.bev_iou_misses_zero.mean, after.bev_iou_misses_zero.mean
    if test is not None and test.is_of_too_few:
        count = test.vehicles or 0
        return (
            f"The figures are of {count} different vehicle{'' if count == 1 else 's'}: too few to say whether the "
            "fine-tuned network is better. Label instants with others."
        )
    if test is None or test.difference is None or test.p_bootstrap is None or first is None or second is None:
        return "Too little was matched to say whether the fine-tuned network is better."
    if test.p_bootstrap >= SIGNIFICANT:
        return (
            "Over whole vehicles the difference in BEV IoU may be chance: record for longer, or label more instants, "
            "before you rely on it."
        )
    if test.difference > 0 and second >= first:
        return "The gain is more than chance: use the fine-tuned weights at this site."
    if test.difference > 0:
        return "Boxes got better but fewer vehicles are found: look at recall before you use the fine-tuned weights."
    return "The fine-tuned network is worse than the baseline: do not use it; check synchronisation and calibration."


def _reservations(before: DetectorFigures, after: DetectorFigures, significance: dict[str, Significance]) -> list[str]:
    found = []
    if _grew(significance.get("ate_m")):
        found.append(
            f"Positions got worse (ATE {_two(before.ate_m.mean)} m to {_two(after.ate_m.mean)} m): "
            "do not take distances from the fine-tuned network."
        )
    if _grew(significance.get("ase")):
        found.append(
            f"Sizes got worse (ASE {_two(before.ase.mean)} to {_two(after.ase.mean)}): "
            "do not take lengths and widths from the fine-tuned network."
        )
    if _grew(significance.get("aoe_deg")):
        found.append(
            f"Headings got worse (AOE {_degrees(before.aoe_deg.mean)} to {_degrees(after.aoe_deg.mean)}): "
            "do not take headings and turns from the fine-tuned network."
        )
    first, second = before.recall.mean, after.recall.mean
    if first is not None and second is not None and first - second >= _CLEAR_LOSS - 1e-9:
        found.append(
            f"Fewer vehicles are found (recall {percent(before.recall.mean)} to {percent(after.recall.mean)}): "
            "counts from the fine-tuned network fall short."
        )
    if _clearly_more(before.false_positives, after.false_positives):
        found.append(
            f"There are more false positives ({before.false_positives} to {after.false_positives}): "
            "look at the tracks for vehicles that are not there."
        )
    if min(before.matched, after.matched) < _FEW_MATCHES:
        found.append(f"The figures rest on only {min(before.matched, after.matched)} matched sightings.")
    return found


def _grew(test: Significance | None) -> bool:
    """Whether an error grew by more than chance."""
    if test is None or test.difference is None or test.p_bootstrap is None:
        return False
    return test.difference > 0 and test.p_bootstrap < SIGNIFICANT


def _clearly_more(before: int | None, after: int | None) -> bool:
    """Of two counts over the same frames."""
    if before is None or after is None:
        return False
    return after >= _CLEAR_RATIO * before and after - before > _CLEAR_Z * float(before + after) ** 0.5


def _without_labels(metrics: Metrics) -> list[str]:
    before, after = (metrics.self_consistency.get(name) for name in ("baseline", "finetuned"))
    given, test = metrics.labelled_instants.given, test_part(metrics)
    missing = f"None of the {given} labelled instants lies in" if given else "There are no labels for"
    sentences = [f"{missing} the test part ({test}), so nothing here says how right the boxes are."]
    if before is not None and after is not None and None not in (before.found, after.found):
        sentences.append(
            "Of the sightings of vehicles that several views show, the network finds "
            f"{_two(before.found)} before and {_two(after.found)} after fine-tuning."
        )
    if before is not None and after is not None and None not in (before.other_views.mean, after.other_views.mean):
        sentences.append(
            "Where it finds them, its boxes, drawn into the other views, overlap what was detected there by an IoU of "
            f"{_two(before.other_views.mean)} before ({before.pairs} pairs) and {_two(after.other_views.mean)} after "
            f"({after.pairs} pairs)."
        )
    sentences.append(
        "That shows whether the views agree, not whether they are right: label some instants of the test part to know. "
        "Labels evaluate and never train; the test part is the end of the recordings."
    )
    return sentences


def test_part(metrics: Metrics) -> str:
    """When the test part is, in words."""
    found = metrics.labelled_instants
    return f"{found.test_from_s:.1f} to {found.test_to_s:.1f} s on the reference camera's clock"


def _moved(before: float | None, after: float | None) -> str:
    first, second = _two(before), _two(after)
    if first == second:
        return f"left BEV IoU at {first}"
    return f"{'lifted' if second > first else 'lowered'} BEV IoU from {first} to {second}"


def _two(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def _degrees(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f}°"
