"""The plain part of YAML is read as by others; what a stranger could hide in the rest is refused with its line."""

from __future__ import annotations

import re

import pytest

from bicycle_env.files import FileError, read_yaml

GOOD = """\
# a comment
---
m: 1093.5   # kg
j_max: 10.0e+3
n: -8.8098e-06
half: .5
steering:
  # indented otherwise
  max: 1.066

    # and here
  min: -1
# back
  inner:
      deep: 3
      text: 'a # b'
trailer:
source: plain words/1.0
empty: ""
"""


def written(tmp_path, content):
    path = tmp_path / "a.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_names_numbers_texts_and_tables(tmp_path, ends):
    assert read_yaml(written(tmp_path, GOOD.replace("\n", ends))) == {
        "m": 1093.5,
        "j_max": 1e4,
        "n": -8.8098e-06,
        "half": 0.5,
        "steering": {"max": 1.066, "min": -1.0, "inner": {"deep": 3.0, "text": "a # b"}},
        "trailer": {},
        "source": "plain words/1.0",
        "empty": "",
    }


BAD = {
    "tag": ("m: !!python/object/apply:os.system ['id']", "line 1: a value must be a number or a plain text"),
    "anchor": ("a: &a 1\nb: *a", "line 1: a value must be"),
    "alias": ("a: 1\nb: *a", "line 2: a value must be"),
    "merge": ("a: 1\n<<: b", "line 2: must be 'name: value'"),
    "list": ("a:\n  - 1", "line 2: must be 'name: value'"),
    "flow": ("a: {b: 1}", "line 1: a value must be"),
    "block": ("a: |\n  text", "line 1: a value must be"),
    "second document": ("a: 1\n---\nb: 2", "line 2: must be 'name: value'"),
    "tab": ("a:\n\tb: 1", "line 2: must be 'name: value'"),
    "twice": ("a: 1\na: 2", "line 2: 'a' stands twice"),
    "indented": ("a: 1\n  b: 2", "line 2: 'b' is indented like no line above"),
    "between": ("a:\n    b: 1\n  c: 2", "line 3: 'c' is indented like no line above"),
    "deep": ("\n".join(" " * k + "a:" for k in range(40)), "nested deeper than 32"),
    "infinite": ("a: .inf", "a must be a finite number"),
    "huge": ("t:\n  a: 1e999", "t.a must be a finite number"),
    "digits": ("a: " + "9" * 90_000 + "$", "line 1: a value must be"),
    "escape": ("a: \x1b]0;owned\x07", "a value must be"),
    "latin-1": ("a: caf\xe9".encode("latin-1"), "not YAML"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_refused_is_one_line(tmp_path, name):
    content, text = BAD[name]
    path = written(tmp_path, content)
    with pytest.raises(FileError, match=re.escape(text)) as caught:
        read_yaml(path)
    assert str(caught.value).startswith(str(path))
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 600
