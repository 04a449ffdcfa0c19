"""The table of tools/line_count.py names what is there, and each line is counted once."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
spec = importlib.util.spec_from_file_location("line_count", ROOT / "tools" / "line_count.py")
line_count = importlib.util.module_from_spec(spec)
spec.loader.exec_module(line_count)

TABLE = {**line_count.FEATURES, **line_count.TASKS}
SOURCE = '''import math
import os


class One:
    """Of one."""

    first: int = 1
    """Its string."""

    @property
    def second(self):
        added = os.sep
        if added:
            added += "x"
        return added


third = math.pi
'''


def test_the_names_of_the_table_exist():
    sources = line_count.sources(None)
    for feature, files in TABLE.items():
        for path, names in files.items():
            for name in names.split():
                assert line_count.lines_of(sources[path], name), (feature, path, name)


def test_every_line_is_counted_once():
    sources = line_count.sources(None)
    counts = line_count.count(sources, TABLE)
    assert sum(lines for lines, _ in counts.values()) == sum(len(text.splitlines()) for text in sources.values())
    assert all(0 <= code <= lines and lines for lines, code in counts.values())


@pytest.mark.parametrize(
    ("names", "lines"),
    [
        ("One.first", {8, 9, 10}),
        ("One.second", set(range(11, 19))),
        ("One.second.added", {13, 15}),
        ("One.second:sep", {13}),
        ("One.second:added", {13, 14, 15, 16, 17, 18}),
        ("third", {19}),
    ],
)
def test_a_name_has_its_lines(names, lines):
    assert line_count.lines_of(SOURCE, names) == lines


def test_an_unknown_name_is_refused():
    with pytest.raises(KeyError, match="fourth"):
        line_count.lines_of(SOURCE, "One.fourth")


def test_code_is_neither_blank_nor_string_nor_import():
    assert line_count.code(SOURCE) == {5, 8, 11, 12, 13, 14, 15, 16, 19}


def test_an_import_belongs_to_those_who_use_it():
    assert line_count.imports(SOURCE, set(range(11, 19))) == {2}
