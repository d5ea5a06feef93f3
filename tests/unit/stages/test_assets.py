"""Files of the site's own: which options use them, and that the others change nothing."""

from __future__ import annotations

import pytest

from tests.builders import site_of
from wibam_core.config import PipelineConfig
from wibam_core.errors import InputError
from wibam_core.jobs.records import Purpose
from wibam_core.stages.assets import ASSETS
from wibam_core.stages.graph import RUN_STAGES, STAGES, InputDigests, downstream, plan

CHOSEN = {"detector": {"detect": {"detector": "custom"}}, "network": {"finetune": {"network": "custom"}}}
#: Stages whose outputs depend on each; what only checks it, aside.
READ_FIRST_BY = {"labels": ("evaluate",), "detector": ("detect",), "network": ("finetune",)}


def changed(asset: str, options: dict[str, dict[str, object]], before: str | None) -> set[str]:
    """Stages that get another address when a file is uploaded, in place of the one of ``before`` if there is one."""
    recordings = dict.fromkeys(site_of().camera_ids, "r")
    old, new = (
        plan(site_of(), PipelineConfig.parse(options), InputDigests(recordings, {asset: file} if file else {}))
        for file in (before, "new")
    )
    return {a.name for a, b in zip(old, new, strict=True) if a.hash != b.hash}


@pytest.mark.parametrize("asset", CHOSEN)
def test_a_file_that_the_options_do_not_use_changes_no_address(asset: str) -> None:
    assert changed(asset, {}, None) == changed(asset, {}, "old") == set()


@pytest.mark.parametrize("asset", READ_FIRST_BY)
def test_a_file_that_is_used_changes_what_depends_on_it(asset: str) -> None:
    first = READ_FIRST_BY[asset]
    checks = {name for name, spec in STAGES.items() if asset in spec.assets and spec.asset_checks}
    expected = {name for stage in first for name in downstream(stage)} | checks
    assert changed(asset, CHOSEN.get(asset, {}), "old") == expected


@pytest.mark.parametrize("asset", CHOSEN)
def test_options_that_ask_for_what_is_not_there_are_refused(asset: str) -> None:
    with pytest.raises(InputError, match=f"is 'custom', but the site has no {asset}") as refused:
        changed(asset, CHOSEN[asset], None)
    assert ASSETS[asset].files[0] in refused.value.hint


def test_everything_that_can_be_uploaded_is_footage_or_an_asset() -> None:
    """Of a job what its site's folder may hold; of a run the network, what comes with it and from the run before."""
    of_jobs, of_runs = ({a for spec in stages.values() for a in spec.assets} for stages in (STAGES, RUN_STAGES))
    uploads = {purpose.value for purpose in Purpose} - {"recording", "footage"}
    assert of_jobs == {name for name, asset in ASSETS.items() if asset.files}
    assert of_runs - of_jobs == {"model", "usual", "track_errors", "open_tracks"}
    assert of_jobs | of_runs == set(ASSETS)
    assert uploads == of_jobs | {"model", "map"}
