"""The report of every kind of car: one page that needs nothing else, its pictures, and its numbers."""

from __future__ import annotations

import base64
import dataclasses
import html.parser
import math
import re
import struct

import pytest
from combinations import only_all, some_of

from bicycle_env import plots, report, vehicles
from bicycle_env.plots.style import DOTS_PER_INCH, png
from bicycle_env.report import pictures
from bicycle_env.report.page import page
from bicycle_env.report.pictures import SUBJECTS
from bicycle_env.report.quantities import Group, Quantity

VOID = {"meta", "img", "br", "link", "hr", "input"}
COARSE = 31
NAMES = ("oversteer", "neutral", "civic")
SMALLER = 4
"""The pictures are drawn with so many times fewer dots per inch."""


class Reader(html.parser.HTMLParser):
    """Collects what a page holds, and complains about tags that do not match."""

    def __init__(self):
        super().__init__()
        self.open, self.tags, self.text = [], [], []

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" not in self.open:
            self.text.append(data)

    def of(self, tag):
        return [attributes for name, attributes in self.tags if name == tag]


def read(text):
    reader = Reader()
    reader.feed(text)
    reader.close()
    assert reader.open == []
    return reader


CASES = [("oversteer", 2), *(only_all((name, len(SUBJECTS))) for name in NAMES)]


@pytest.fixture(scope="module", params=CASES, ids=lambda case: f"{case[0]}-{case[1]}")
def written(request, tmp_path_factory):
    """A report on every kind of car, on a coarse grid, with some pictures: (name, folder, what was told, pictures)."""
    name, count = request.param
    folder = tmp_path_factory.mktemp(name) / "new" / "folder"
    told = []
    study = report.study(name, grid=COARSE)
    study.__dict__["shares"] = {"recoverable": 0.5, "lqr": 0.4, "straight": 0.1}  # take long, and are not asked
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plots, "png", lambda figure: png(figure, DOTS_PER_INCH / SMALLER))
        patch.setattr(pictures, "SUBJECTS", SUBJECTS[:count])
        path = report.write(study, folder, told.append)
    assert path == folder / "report.html"
    return name, folder, told, {f"{subject.name}.png" for subject in SUBJECTS[:count]}


def test_the_page_and_its_pictures_are_directly_in_the_folder(written):
    _, folder, told, drawn = written
    assert {path.name for path in folder.iterdir()} == drawn | {"report.html"}
    assert sum("drawing" in line for line in told) == len(drawn)
    for file in drawn:
        content = (folder / file).read_bytes()
        assert content.startswith(b"\x89PNG")
        width, height = struct.unpack(">II", content[16:24])
        assert 1000 < SMALLER * width < 2500
        assert 500 < SMALLER * height < 2500


def test_the_page_needs_nothing_else(written):
    name, folder, _, drawn = written
    text = (folder / "report.html").read_text(encoding="utf-8")
    page = read(text)
    assert text.startswith("<!DOCTYPE html>")
    assert not page.of("script")
    assert not page.of("link")
    assert "@import" not in text
    assert "url(" not in text
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    for _, attributes in page.tags:
        for key in ("src", "href"):
            if key in attributes:
                assert attributes[key].startswith(("data:image/png;base64,", "#"))
    assert {link["href"][1:] for link in page.of("a")} <= set(ids)

    pictures = page.of("img")
    assert {base64.b64decode(picture["src"].partition(",")[2]) for picture in pictures} == {
        (folder / file).read_bytes() for file in drawn
    }
    assert all(len(picture["alt"]) > 40 for picture in pictures)
    words = " ".join(page.text)
    assert not re.search(r"\b(nan|inf|None|True|False|array)\b", words.replace("“None”", ""))
    assert name in words
    assert vehicles[name].source in words
    for number in (vehicles[name].mass, vehicles[name].front_cornering_stiffness):
        assert f"{number:,.0f}" in words or f"{number:.4g}" in words


def test_the_words_fit_the_car(written):
    name, folder, *_ = written
    words = " ".join(read((folder / "report.html").read_text(encoding="utf-8")).text)
    critical = vehicles[name].critical_speed
    if math.isinf(critical):
        assert "x the critical speed" not in words
        assert "none: stable at every speed" in words
        assert "it is stable at every speed" in words
    else:
        assert "1.2 x the critical speed" in words
        assert f"{critical:.1f} m/s, the critical speed (6.17), one crosses zero" in words
        assert "a deviation eventually doubles every" in words


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", some_of(vehicles, NAMES))
def test_every_preset_has_words_for_every_picture(name):
    study = report.study(name, grid=COARSE)
    for subject in SUBJECTS:
        for words in (subject.caption(study), subject.alternative(study)):
            assert len(words) > 80
            assert not re.search(r"\b(nan|inf|None)\b|  ", words)


def test_words_of_the_user_are_escaped():
    row = Quantity("name", "<b>label", 1.0, "&unit", "", "<script>alert(1)</script>")
    text = page("a < b", '"summary"', Group("<i>", (row,)), "source & <u>", (), (), ("<note>",))
    reader = read(text)
    assert not {"b", "i", "u", "note", "script"} & {tag for tag, _ in reader.tags}
    assert "source & <u>" in "".join(reader.text)


@pytest.mark.exhaustive
def test_a_second_report_replaces_the_first_and_leaves_no_other_files(tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "SUBJECTS", SUBJECTS[:1])
    study = report.study("oversteer", speed=20.0, grid=COARSE)
    report.write(study, tmp_path)
    mine = dataclasses.replace(study, vehicle=dataclasses.replace(study.vehicle, name="<mine>"))
    report.write(mine, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"root_locus.png", "report.html"}
    assert "&lt;mine&gt; at 20.0 m/s = 72 km/h" in (tmp_path / "report.html").read_text(encoding="utf-8")
