"""Reading from strangers: each damage is one line that names the file, before much is read or computed."""

import json
import os
import re
import socket

import pytest

from bicycle_env.files import (
    FileError,
    listed,
    mapping,
    number_in,
    one_of,
    parse_json,
    read_bytes,
    read_json,
    read_table,
    read_toml,
    shown,
    table,
    text,
    whole_in,
)
from bicycle_env.files.reading import LONG_KEY

CHECK = table(
    {"count": whole_in(1, 10), "rate": number_in(0.0, 1.0)},
    {"word": one_of(["red", "blue"]), "names": listed(text(5), most=3), "more": mapping(number_in(0, 9), most=2)},
)
GOOD = {"count": 3, "rate": 0.5}


def one_line(caught, path):
    words = str(caught.value)
    assert words.startswith(f"{path}: ")
    assert words.isprintable()
    assert len(words) < 1000
    return True


# What is not a regular file, or too large


@pytest.mark.parametrize("kind", ["folder", "fifo", "socket", "/dev/zero", "null character"])
def test_only_regular_files_are_read_and_nothing_waits(tmp_path, kind, monkeypatch):
    path = tmp_path / "x"
    if kind == "folder":
        path.mkdir()
    elif kind == "fifo":
        os.mkfifo(path)
    elif kind == "socket":
        monkeypatch.chdir(tmp_path)  # a socket's name may not be long
        server = socket.socket(socket.AF_UNIX)
        server.bind("x")
        server.close()
    elif kind == "null character":
        path = "a\0b"
    else:
        path = kind
    for read in (read_bytes, read_json, read_toml):
        with pytest.raises(FileError, match="must be a regular file" if kind != "null character" else "null") as caught:
            read(path)
        assert one_line(caught, shown(path))


def test_a_fifo_that_takes_the_files_place_keeps_nobody_waiting(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("{}")
    os.mkfifo(tmp_path / "fifo")
    original = os.stat
    with monkeypatch.context() as patch:
        patch.setattr(os, "stat", lambda path: original(tmp_path / "file"))
        with pytest.raises(FileError, match="a FIFO"):
            read_bytes(tmp_path / "fifo")


def test_a_sparse_giant_is_refused_before_it_is_read(tmp_path, monkeypatch):
    path = tmp_path / "giant.json"
    with path.open("wb") as file:
        file.truncate(3 * 10**9)

    class Watched:
        def __init__(self, descriptor, mode):
            self.file = fdopen(descriptor, mode)

        def __enter__(self):
            return self

        def __exit__(self, *_):
            self.file.close()

        fileno = property(lambda self: self.file.fileno)

        def read(self, *_):
            raise AssertionError("read")

    fdopen = os.fdopen
    monkeypatch.setattr(os, "fdopen", Watched)
    with pytest.raises(FileError, match="must not be larger than 1000000 bytes, has 3000000000"):
        read_json(path)


def test_a_file_that_grows_while_it_is_read_is_refused(tmp_path, monkeypatch):
    """As those of /proc do, whose size reads 0."""
    (tmp_path / "small").write_bytes(b"")
    (tmp_path / "large").write_bytes(b"1" * 20)
    small = os.stat(tmp_path / "small")
    monkeypatch.setattr(os, "fstat", lambda _: small)
    with pytest.raises(FileError, match="larger than 10 bytes, has 11"):
        read_bytes(tmp_path / "large", 10)
    assert read_bytes(tmp_path / "large", 20) == b"1" * 20


def test_a_missing_file_is_the_operating_systems_error(tmp_path):
    with pytest.raises(FileNotFoundError) as caught:
        read_json(tmp_path / "nowhere.json")
    assert str(caught.value.filename) == str(tmp_path / "nowhere.json")


# What it holds

BAD_JSON = [
    (b"", "not JSON: Expecting value"),
    (b"{", "not JSON"),
    (b"{} {}", "not JSON: Extra data"),
    (b"{'a': 1}", "not JSON"),
    (b"\x80abc", "not JSON: 'utf-8' codec can't decode"),
    ('{"a": 1}'.encode("utf-16"), "not JSON"),
    (b'{"a": NaN}', "a must be a finite number, got nan"),
    (b'{"a": [1, {"b": -Infinity}]}', r"a[1].b must be a finite number, got -inf"),
    (b"1e999", "the value must be a finite number, got inf"),
    (b"[-1e999]", "[0] must be a finite number, got -inf"),
    (b"1" * 5000, "not JSON"),
    (b'{"a": ' + b"9" * 400 + b"}", "a must be a number of at most 128 bits"),
    (b'{"a": 1, "b": 2, "a": 3}', "not JSON: 'a' stands twice"),
    (b'{"x": {"a": 1, "a": 1}}', "'a' stands twice"),
    (b"[" * 33 + b"]" * 33, "nested deeper than 32"),
    (b'{"a":' * 40 + b"1" + b"}" * 40, "nested deeper than 32"),
    (b"[" * 500_000, "nested deeper than 32"),
    (b'{"a": "\\ud800"}', "a holds what is no Unicode: '\\ud800'"),
    (b'{"\\udfff": 1}', "a key holds what is no Unicode"),
    (b'{"a": "\x1b[31m"}', "not JSON: Invalid control character"),
    (b'{"' + b"k" * 100_000 + b'": [NaN]}', "must be a finite number"),
]
BAD_TOML = [
    (b"a", "not TOML"),
    (b"a = 1\na = 2", "not TOML"),
    (b"a = nan", "a must be a finite number"),
    (b"a = -inf", "a must be a finite number"),
    (b"a = 1e999", "a must be a finite number"),
    (b"a = 0x" + b"f" * 40, "a must be a number of at most 128 bits"),
    (b"a = 1979-05-27", "a must be a number, a text, a list or a table, got a date"),
    (b"a = 07:32:00", "got a time"),
    (b"a = \x80", "not TOML: 'utf-8' codec"),
    (b"a = '\x1b[31m'", "not TOML"),
    (b"a = " + b"[" * 40 + b"]" * 40, "nested deeper than 32"),
    (b"a = " + b"[" * 100_000, "not TOML"),
    (b"a" + b".a" * 32 + b" = 1", "a key of more than 32 parts"),
    (b"x = 1\n[a" + b" . 'b'" * 50_000 + b"]", "a key of more than 32 parts"),
    (b"x = {a" + b'."b"' * 50_000 + b" = 1}", "a key of more than 32 parts"),
]


@pytest.mark.parametrize(
    ("suffix", "content", "words"),
    [("json", *row) for row in BAD_JSON] + [("toml", *row) for row in BAD_TOML],
    ids=str,
)
def test_damage_is_one_line(tmp_path, suffix, content, words):
    path = tmp_path / f"x.{suffix}"
    path.write_bytes(content)
    with pytest.raises(FileError, match=re.escape(words)) as caught:
        read_table(path)
    assert one_line(caught, path)


@pytest.mark.parametrize("content", ["a" * 900_000, "a " * 450_000, "a." * 450_000, '"' * 900_000, "'a'." * 8_000])
def test_the_search_for_long_keys_comes_to_an_end(content):
    """Each would take minutes if the search went back over what it has read."""
    LONG_KEY.search(content)


def test_what_is_good_comes_back(tmp_path):
    content = {"a": [1, -2.5, True, None, "tr\u00e4ge"], "b": {"c": 2**127}, "": {}}
    (tmp_path / "x.json").write_bytes(b"\xef\xbb\xbf" + json.dumps(content).encode())
    assert read_table(tmp_path / "x.json") == read_json(str(tmp_path / "x.json")) == content
    (tmp_path / "x.TOML").write_text("a = [1, -2.5, true]\n[b.c]\nd = 'e'\n" + "e" + ".e" * 28 + " = 1")
    read = read_table(tmp_path / "x.TOML")
    assert read["a"] == [1, -2.5, True]
    assert read["b"]["c"]["d"] == "e"
    assert parse_json("[" * 32 + "]" * 32, "here") is not None
    assert parse_json('{"a": 1}', "--env-keywords") == {"a": 1}


def test_text_in_memory_is_held_to_the_same_rules():
    for content, words in ((b"1" * 11, "larger than 10 bytes"), ("\ud800", "no Unicode"), ("[1e999]", "finite")):
        with pytest.raises(FileError, match=f"^--env-keywords: .*{words}"):
            parse_json(content, "--env-keywords", largest=10)


# Schema


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ([], "the content must be a table of count, rate, word, names, more, got a list"),
        (None, "got nothing"),
        ({"count": 3}, "the content must have the keys count, rate; missing: 'rate'"),
        ({**GOOD, "wrod": "red"}, "unknown key 'wrod'; did you mean 'word'?"),
        ({**GOOD, "count": 11}, "count must be a whole number in [1, 10], got 11"),
        ({**GOOD, "count": 3.0}, "count must be a whole number"),
        ({**GOOD, "count": True}, "count must be a whole number"),
        ({**GOOD, "rate": 2}, "rate must be a finite number in [0, 1], got 2.0"),
        ({**GOOD, "rate": "x"}, "rate must be a finite number"),
        ({**GOOD, "word": "rde"}, "word must be one of 'red', 'blue', got 'rde'; did you mean 'red'?"),
        ({**GOOD, "word": ["red"]}, "word must be one of"),
        ({**GOOD, "names": "abc"}, "names must be a list, got a str"),
        ({**GOOD, "names": ["a"] * 4}, "names must have 0 to 3 entries, has 4"),
        ({**GOOD, "names": ["a", 1]}, "names[1] must be a text, got a int"),
        ({**GOOD, "names": ["abcdef"]}, "names[0] must have at most 5 characters, has 6"),
        ({**GOOD, "more": []}, "more must be a table, got a list"),
        ({**GOOD, "more": {"a": 1, "b": 1, "c": 1}}, "more must have at most 2 entries, has 3"),
        ({**GOOD, "more": {"a": 10}}, "more.a must be a finite number in [0, 9]"),
        ({**GOOD, "word": "\x1b[2J\u202e" + "y" * 5000}, "got '\\x1b[2J\\u202eyyy"),
    ],
    ids=str,
)
def test_what_the_schema_refuses(tmp_path, content, words):
    path = tmp_path / "x.json"
    path.write_text(json.dumps(content))
    with pytest.raises(FileError, match=re.escape(words)) as caught:
        read_json(path, CHECK)
    assert one_line(caught, path)


def test_what_the_schema_takes(tmp_path):
    full = {**GOOD, "word": "blue", "names": ["a"], "more": {"a": 1}}
    for content in (GOOD, full):
        (tmp_path / "x.json").write_text(json.dumps(content))
        assert read_json(tmp_path / "x.json", CHECK) == content
    assert table({}, {"a": text()}, others=True)("", {"b": 1}) == {"b": 1}


# Showing


def test_shown_is_one_printable_line():
    hostile = "a\x1b[31m\r\n\t\x00\x9b\u202e\u200b\u2028\ud800[/red]\U000e0001"
    assert shown(hostile) == ("a\\x1b[31m\\r\\n\\t\\x00\\x9b\\u202e\\u200b\\u2028\\ud800[/red]\\U000e0001")
    assert shown("tr\u00e4ge 5 \u00b0") == "tr\u00e4ge 5 \u00b0"
    assert shown("x" * 400) == "x" * 400
    assert shown("x" * 401) == "x" * 400 + " ..."
    assert shown("\n" * 400, 10) == "\\n" * 5 + " ..."
    assert shown(3.5) == "3.5"


def test_a_hostile_file_name_is_escaped(tmp_path):
    path = tmp_path / "a\x1b[31m\nb.json"
    path.write_text("{")
    with pytest.raises(FileError, match=re.escape(r"a\x1b[31m\nb.json: not JSON")):
        read_json(path)
