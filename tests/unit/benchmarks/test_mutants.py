"""Mistakes that are written into the source to try the tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.known_mutants import KNOWN, Mistake
from benchmarks.mutants import ROOT, mistakes_in, random_mistakes, unit_tests

SOURCE = '''"""A module."""

LIMIT = 3.0


def within(a: float, b: float) -> bool:
    """Whether they lie within the limit."""
    return a - b < LIMIT and -a > 2.0 * b or not True
'''


@pytest.mark.parametrize("mistake", KNOWN, ids=lambda mistake: mistake.name)
def test_known_mistakes_change_a_line_that_is_there(mistake: Mistake) -> None:
    assert (ROOT / mistake.path).read_text(encoding="utf-8").count(mistake.right) == 1
    assert mistake.wrong != mistake.right
    assert all((ROOT / tests).exists() for tests in mistake.tests)


def test_one_operator_sign_number_or_truth_value_is_changed_at_a_time() -> None:
    changed = {mistake.name.split(": ", 1)[1] for mistake in mistakes_in(Path("m.py"), SOURCE, ())}
    assert changed == {
        "return a + b < LIMIT and -a > 2.0 * b or not True",
        "return a - b <= LIMIT and -a > 2.0 * b or not True",
        "return a - b < LIMIT or -a > 2.0 * b or not True",
        "return a - b < LIMIT and a > 2.0 * b or not True",
        "return a - b < LIMIT and -a >= 2.0 * b or not True",
        "return a - b < LIMIT and -a > 2.0 / b or not True",
        "return a - b < LIMIT and -a > 4.0 * b or not True",
        "return a - b < LIMIT and -a > 2.0 * b and not True",
        "return a - b < LIMIT and -a > 2.0 * b or not False",
    }


def test_a_seed_draws_the_same_from_modules_that_have_tests() -> None:
    one, again, other = (random_mistakes(seed, 12, "tracking") for seed in (1, 1, 2))
    assert one == again != other
    assert len(one) == 12
    assert {mistake.tests for mistake in one} == {("tests/unit/tracking",)}
    assert unit_tests(Path("wibam_core/networks/small/decode.py")) == ("tests/unit/networks/small",)
    assert unit_tests(Path("wibam_core/text.py")) == ("tests/unit/test_text.py",)
