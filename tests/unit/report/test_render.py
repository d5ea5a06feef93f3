"""The page: self-contained, escaped, accessible, the same bytes twice."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from tests.builders import AMBIGUOUS
from tests.unit.report.scenes import report_data
from wibam_core.documents.rounds import Rounds
from wibam_core.documents.synchronisation import Alternative, PlacedSegment, SoundPair, TrafficPair
from wibam_core.report.data import ClockRow, Synchronisation, Training
from wibam_core.report.render import render

HOSTILE = "<script>alert(1)</script> \"quoted\" & 'Straße' $x^2$ {{ 7*7 }}"


class Outline(HTMLParser):
    """Collects what the tests ask for."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attrs for name, attrs in self.tags if name == tag]


@pytest.fixture(scope="module")
def page() -> str:
    return render(report_data())


@pytest.fixture(scope="module")
def outline(page: str) -> Outline:
    return Outline(page)


def test_nothing_comes_from_anywhere_else(page, outline):
    assert not outline.all("script") and not outline.all("iframe") and not outline.all("object")
    for tag, attrs in outline.tags:
        for name in ("src", "href", "srcset", "action", "data"):
            value = attrs.get(name)
            assert value is None or value.startswith(("data:", "#")), (tag, value)
    assert "url(" not in page.split("</style>")[0] and "@import" not in page
    assert "default-src 'none'" in page


def test_size(page):
    assert len(page.encode()) < 6e6


def test_pictures_have_words_and_tables_have_headings(outline):
    images = outline.all("img")
    assert len(images) >= 17
    assert all(image["alt"] and image["width"] for image in images)
    assert outline.all("th") and all(heading["scope"] in ("row", "col", "colgroup") for heading in outline.all("th"))
    assert len(outline.all("caption")) == len(outline.all("table"))
    assert outline.all("html")[0]["lang"] == "en"


def test_contents_lead_somewhere(outline):
    ids = {attrs["id"] for _, attrs in outline.tags if attrs.get("id")}
    targets = [link["href"][1:] for link in outline.all("a")]
    assert len(targets) == 11 and set(targets) <= ids


def test_the_same_bytes_twice(page):
    assert render(report_data()) == page


def test_pictures_say_nothing_of_the_clock(outline):
    svgs = [i["src"] for i in outline.all("img") if i["src"].startswith("data:image/svg+xml")]
    for uri in svgs:
        svg = base64.b64decode(uri.split(",")[1]).decode()
        assert "<dc:date>" not in svg and "http-equiv" not in svg


def text_alone(**changes) -> str:
    """The page without what is slow to draw, and without labels."""
    bare = replace(report_data(labels=False), tracks=(), examples=(), boxes=(), clusters=(), typical_images={})
    return render(replace(bare, **changes))


def test_hostile_names_stay_text():
    page = text_alone(site_name=HOSTILE, warnings=(AMBIGUOUS.model_copy(update={"message": HOSTILE}),))
    assert "<script>" not in page and "&lt;script&gt;alert(1)&lt;/script&gt;" in page
    assert "{{ 7*7 }}" in page and "Straße" in page


def test_warnings_stand_above_all_figures():
    page = text_alone()
    top = page[page.index("<h1>") : page.index('<dl class="tiles">')]
    assert AMBIGUOUS.message in top and AMBIGUOUS.hint in top
    assert 'role="note"' in top
    assert AMBIGUOUS.message not in text_alone(warnings=())


def test_clocks_that_were_taken_to_be_one_are_said_to_be(page):
    assert "share one clock" in text_alone(synchronisation=Synchronisation((), (), measured=False))
    assert "share one clock" not in page


def test_what_clocks_rest_on_stands_in_tables(page):
    pair = TrafficPair(
        first="north", second="east", offset_s=-1.5, drift_ppm=12.0, matched=31, could=40.0, score=0.775, clear=True,
        sd_s=0.008, drift_sd_ppm=20.0, residual_s=-0.0034, alternatives=[],
    )  # fmt: skip
    rival = Alternative(offset_s=61.0, matched=20, could=22.0, score=0.91)
    worse = Alternative(offset_s=-59.0, matched=4, could=20.0, score=0.2, excluded=True)
    unclear = pair.model_copy(update={"second": "west", "clear": False, "alternatives": [rival, worse]})
    few = pair.model_copy(update={"second": "south", "clear": False, "sd_s": None, "residual_s": None})
    heard = SoundPair(
        first="north", second="east", offset_s=-1.6, sd_s=0.09, strength=14.0, contrast=2.31, clear=True,
        residual_s=-0.104, agrees=True,
    )  # fmt: skip
    vague = heard.model_copy(update={"second": "west", "clear": False, "agrees": None, "contrast": 1.02})
    other = heard.model_copy(update={"second": "south", "agrees": False, "residual_s": 60.1})
    shown = text_alone(
        synchronisation=Synchronisation(
            (),
            (),
            sounds=(heard, vague, other),
            candidates=(("east", rival), ("east", worse)),
            pairs=(pair, unclear, few),
            segments=(("west", PlacedSegment(from_s=300.0, shift_s=61.3, sd_s=0.004, matched=17)),),
        )
    )
    cells = re.sub(r"<[^>]+>", "|", shown)
    assert "east against north||−1.500 ± 0.008||+12 ± 20||31 of 40 (78%)||−3.4||used" in cells
    assert "west against north||" in cells and "not used: +61.00 s (91%) as likely" in cells
    assert "not used: too few road users" in cells
    assert "east||+61.00||+0||20 of 22 (91%)||as likely" in cells
    assert "east||−59.00||+0||4 of 20 (20%)||excluded" in cells
    assert "west||300.0||+61.300 ± 0.004||17" in cells
    assert "east against north||−1.60 ± 0.09||2.3||−0.10||agrees" in cells
    assert "west against north||−1.60 ± 0.09||1.0||−0.10||not used: not clear" in cells
    assert "south against north||−1.60 ± 0.09||2.3||+60.10||says otherwise" in cells
    assert "Table of what the traffic says" not in page and "Table of what the sound says" not in page


def test_a_clock_s_row_says_who_chose_it():
    row = ClockRow("east", 1.5, 0.004, 0.0, None, 24, 0.3, 0.006)
    rows = (row, replace(row, camera_id="west", by_sound=True), replace(row, camera_id="south", by_traffic=True))
    cells = re.sub(r"<[^>]+>", "|", text_alone(synchronisation=Synchronisation(rows, ())))
    for said in (
        "east||+1.5000 ± 0.0040||",
        "west||+1.5000 ± 0.0040, by the sound||",
        "south||+1.5000 ± 0.0040, by the traffic||",
    ):
        assert said in cells


def test_without_labels_there_is_no_accuracy_but_agreement(page):
    bare = text_alone()
    assert "There are no labels for the test part" in bare
    # the overlap is of what is found, so that it says little before the share that is
    assert bare.index("found of what several views see") < bare.index("agreement of views where found")
    assert "90 %" in bare and "30 %" in bare
    assert 'class="results"' not in bare and "thin white lines are labels" not in bare
    assert "0.71 ± 0.20" in bare
    assert 'class="results"' in page and "thin white lines are labels" in page


def test_rounds_are_shown_where_there_were_any(page):
    assert "What each round found" in page and "1: taught network (kept)" in page
    assert page.index("27 %") < page.index("83 %")
    none = text_alone(rounds=Rounds(rounds=[], kept=0, reason="rounds are switched off"))
    assert "What each round found" not in none and "overlooked:" not in none
    (first, _) = report_data(labels=False).rounds.rounds
    judged = text_alone(rounds=Rounds(rounds=[first], kept=0, reason="cameras have boxes of 95 % of them"))
    assert "What each round found" not in judged and "overlooked: cameras have boxes of 95 % of them" in judged


def test_the_bold_figures_are_the_fine_tuned_networks(page):
    first_row = page[page.index('<th scope="row">BEV IoU</th>') :].partition("</tr>")[0]
    bold = re.findall(r'<td class="ours">([^<\s]+)', first_row)
    assert bold == ["0.72"]
    assert page.count('<th scope="col">baseline</th>') == page.count('<th scope="col">baseline (plane)</th>') == 2


def test_the_caption_speaks_of_grey_tracks_only_where_there_are_any(page):
    assert "those involved; all other tracks are grey." in page
    involved = tuple(track for track in report_data().tracks if track.track_id in (1, 3))
    assert "those involved." in text_alone(tracks=involved)


def test_the_note_says_what_the_most_braking_means(page):
    assert "&gt; 10 is more than tyres can do" in page


def test_overlaps_and_what_the_traffic_says_of_the_cameras_are_told(page):
    assert "Cameras were corrected by the traffic, by 40 vehicles" in page
    assert "The road lies −0.25 m from where the calibration had it, with a slope of 0.5 % against it" in page
    assert re.search(r'<th scope="row">cam1</th><td>0.31</td><td>0.12</td><td>–</td><td>−14</td>', page)
    assert '<th scope="row">cam1 and cam2</th>' in page
    kept = report_data().refinement.model_copy(update={"taken": False, "cameras": {}, "reason": "too few vehicles"})
    text = text_alone(refinement=kept, overlap=None)
    assert "Cameras are as they were calibrated: too few vehicles." in text and "both see" not in text


def test_with_nothing_found_the_page_still_stands():
    page = text_alone(
        conflicts=(), synchronisation=Synchronisation((), ()), training=Training((), (), 0, ()), stages=()
    )
    assert "No track was found." in page and "No conflict with" in page
    assert "No frame of the test part shows a vehicle." in page
    assert not re.search(r"\bNone\b", re.sub(r"<[^>]+>", " ", page.split("</style>")[1]))


def test_no_raw_python_shows(page):
    text = re.sub(r"<[^>]+>", " ", page.split("</style>")[1])
    assert not re.search(r"\b(None|nan|inf|True|False|object at)\b", text)
