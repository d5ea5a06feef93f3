import pytest

from wibam_core.training.schedule import CosineSchedule, LearningRateSchedule, PlateauSchedule


def test_cosine_rises_then_falls_to_nearly_nothing() -> None:
    schedule = CosineSchedule(1.0, 100)
    rates = [schedule.rate(step) for step in range(100)]
    assert rates[0] == pytest.approx(0.2, abs=0.01)
    assert max(rates) == rates[4]
    assert rates[4:] == sorted(rates[4:], reverse=True)
    assert rates[-1] < 0.015


def test_plateau_divides_by_ten_after_four_epochs_without_improvement() -> None:
    schedule: LearningRateSchedule = PlateauSchedule(1.0)
    rates = []
    for loss in [1.0, 0.9, 0.8995, 0.91, 0.92, 0.8999, 0.5, 0.5, 0.5, 0.5, 0.5]:
        schedule = schedule.after_epoch(loss)
        rates.append(schedule.rate(0))
    assert rates == pytest.approx([1, 1, 1, 1, 1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.01])
