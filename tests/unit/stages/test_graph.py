"""The pipeline's graph: order, addresses, and what changes them."""

from __future__ import annotations

import pytest

from tests.builders import site_of
from wibam_core.config import PipelineConfig
from wibam_core.errors import UnknownOption
from wibam_core.site import Origin, SignalRegion
from wibam_core.stages.graph import STAGES, InputDigests, PlannedStage, downstream, plan

DIGESTS = InputDigests({"cam1": "a", "cam2": "b", "cam3": "c", "cam4": "d"}, {"labels": "e"})


def changed(**options: dict[str, object]) -> set[str]:
    """Stages whose outputs get another address through options."""
    before = plan(site_of(), PipelineConfig(), DIGESTS)
    after = plan(site_of(), PipelineConfig.parse(options), DIGESTS)
    return {a.name for a, b in zip(after, before, strict=True) if a.hash != b.hash}


def test_every_stage_comes_after_those_it_requires_and_has_options() -> None:
    seen: set[str] = set()
    for name, spec in STAGES.items():
        assert set(spec.requires) <= seen
        spec.config(PipelineConfig())
        seen.add(name)


def test_the_same_inputs_give_the_same_addresses() -> None:
    assert plan(site_of(), PipelineConfig(), DIGESTS) == plan(site_of(), PipelineConfig(), DIGESTS)


def test_an_option_changes_its_stage_and_all_after_it_alone() -> None:
    assert changed(finetune={"steps": 17}) == {"finetune", "predict", "evaluate", "track", "safety", "report"}
    assert changed(track={"rate_hz": 5.0}) == {"predict", "evaluate", "track", "safety", "report"}
    assert changed(track={"gate_m": 3.0}) == {"track", "safety", "report"}
    assert changed(evaluate={"min_score": 0.3}) == {"evaluate", "report"}
    assert changed(safety={"ttc_s": 2.5}) == {"safety", "report"}
    assert changed(sync={"method": "none"}) == set(STAGES) - {"preflight", "calibrate"}


@pytest.mark.parametrize(
    ("options", "frames_anew"),
    [
        ({"sync": {"method": "none"}}, set()),
        ({"preflight": {"min_overlap_s": 1.0}}, {"detect"}),  # whose timestamps say what shows the background
        ({"frames": {"rate_hz": 5.0}}, set()),
        ({"detect": {"rate_hz": 2.0}}, set()),
        ({"frames": {"width_px": 640}}, {"frames", "detect"}),
        ({"frames": {"jpeg_quality": 70}}, {"frames", "detect"}),
        ({"detect": {"min_score": 0.5}}, {"detect"}),
        ({"detect": {"background_s": 60.0}}, {"detect"}),
    ],
)
def test_clocks_and_rates_change_nothing_that_is_made_of_a_frame(
    options: dict[str, object], frames_anew: set[str]
) -> None:
    before = plan(site_of(), PipelineConfig(), DIGESTS)
    after = plan(site_of(), PipelineConfig.parse(options), DIGESTS)
    assert {a.name for a, b in zip(after, before, strict=True) if a.frame_hash != b.frame_hash} == frames_anew
    assert {stage.name for stage in after if stage.frame_hash is not None} == {"frames", "detect"}
    assert "detect" in changed(**options)


def test_labels_only_change_what_checks_them_and_what_evaluates() -> None:
    """New labels must be checked before anything long begins, and must not train anything again."""
    without = InputDigests(DIGESTS.recordings, {})
    before, after = (plan(site_of(), PipelineConfig(), d) for d in (DIGESTS, without))
    assert {a.name for a, b in zip(after, before, strict=True) if a.hash != b.hash} == {
        "preflight",
        "evaluate",
        "report",
    }


def test_a_new_recording_changes_everything_that_looks_at_videos() -> None:
    other = InputDigests({**DIGESTS.recordings, "cam2": "x"}, DIGESTS.assets)
    before, after = (plan(site_of(), PipelineConfig(), d) for d in (DIGESTS, other))
    assert [a.name for a, b in zip(after, before, strict=True) if a.hash == b.hash] == ["calibrate"]


def test_a_new_recording_changes_what_is_made_of_a_frame_and_a_signal_region_does_not() -> None:
    other = InputDigests({**DIGESTS.recordings, "cam2": "x"}, DIGESTS.assets)
    first, *rest = site_of().cameras
    region = SignalRegion(id="north", region=(0, 0, 9, 9))
    signals = site_of().model_copy(update={"cameras": (first.model_copy(update={"signals": (region,)}), *rest)})
    hashes = [
        {stage.name: stage.frame_hash for stage in plan(site, PipelineConfig(), digests)}
        for site, digests in ((site_of(), DIGESTS), (site_of(), other), (signals, DIGESTS))
    ]
    assert hashes[0] == hashes[2]
    assert all(hashes[0][stage] != hashes[1][stage] for stage in ("frames", "detect"))


def test_renaming_the_site_changes_the_report_alone() -> None:
    before = plan(site_of(), PipelineConfig(), DIGESTS)
    after = plan(site_of(name="elsewhere"), PipelineConfig(), DIGESTS)
    assert {a.name for a, b in zip(after, before, strict=True) if a.hash != b.hash} == {"report"}


def test_where_the_site_lies_on_earth_changes_the_report_alone() -> None:
    located = site_of().model_copy(update={"origin": Origin(latitude_deg=48.0, longitude_deg=11.0)})
    before, after = (plan(site, PipelineConfig(), DIGESTS) for site in (site_of(), located))
    assert [a.name for a, b in zip(after, before, strict=True) if a.hash != b.hash] == ["report"]


def test_downstream_follows_the_graph() -> None:
    assert downstream("track") == ("track", "safety", "report")
    assert downstream("preflight") == tuple(name for name in STAGES if name != "calibrate")
    with pytest.raises(UnknownOption, match="no stage 'paint'"):
        downstream("paint")


def test_downstream_of_a_plan_follows_every_branch() -> None:
    shape = {"a": (), "b": ("a",), "c": ("a",), "d": ("b", "c"), "e": ("d",), "f": ()}
    stages = [PlannedStage(name, "h", requires) for name, requires in shape.items()]
    assert downstream("a", stages) == ("a", "b", "c", "d", "e")
    assert downstream("c", stages) == ("c", "d", "e")
    assert downstream("f", stages) == ("f",)


def test_unknown_options_are_named() -> None:
    with pytest.raises(UnknownOption, match=r"finetune\.stepz: there is no such option"):
        PipelineConfig.parse({"finetune": {"stepz": 3}})
    with pytest.raises(UnknownOption, match=r"finetune\.steps"):
        PipelineConfig.parse({"finetune": {"steps": -3}})


def test_a_given_stage_has_the_address_of_what_is_given_alone() -> None:
    def addresses(given: dict[str, str], **options: dict[str, object]) -> dict[str, str]:
        inputs = InputDigests(DIGESTS.recordings, DIGESTS.assets, given)
        planned = plan(site_of(), PipelineConfig.parse(options), inputs)
        assert all(not stage.requires for stage in planned if stage.name in given)
        return {stage.name: stage.hash for stage in planned}

    def changed_to(other: dict[str, str]) -> set[str]:
        return {name for name, hash in other.items() if hash != first[name]}

    first = addresses({"detect": "a", "associate": "b"})
    # rounds would look for vehicles as the options of detection say
    changed = changed_to(addresses({"detect": "a", "associate": "b"}, detect={"rate_hz": 3.0}))
    assert changed == {*downstream("rounds")} - {"associate"}
    assert changed_to(addresses({"detect": "c", "associate": "b"})) == {"detect", *downstream("rounds")} - {"associate"}
    assert changed_to(addresses({"detect": "a", "associate": "c"})) == set(downstream("associate"))
    assert changed_to(addresses({})) == set(downstream("detect"))
