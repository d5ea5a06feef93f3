"""Errors keep their code and words across a process boundary."""

from __future__ import annotations

from wibam_core.errors import MissingCamera, WibamError, _by_code


def test_codes_are_unique_along_the_tree() -> None:
    pending, codes = [WibamError], []
    while pending:
        cls = pending.pop()
        if "code" in vars(cls):
            codes.append(cls.code)
        pending.extend(cls.__subclasses__())
    assert len(codes) == len(set(codes))
    assert set(codes) == set(_by_code())


def test_an_error_survives_the_wire() -> None:
    error = MissingCamera("there is no recording of camera c", camera="c")
    back = WibamError.from_dict(error.to_dict())
    assert type(back) is MissingCamera
    assert back.to_dict() == error.to_dict()
    assert error.hint


def test_an_unknown_code_stays_readable() -> None:
    back = WibamError.from_dict({"code": "from_the_future", "message": "m"})
    assert (back.code, back.message) == ("from_the_future", "m")
