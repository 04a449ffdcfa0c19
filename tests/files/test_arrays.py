"""Arrays as data: what is written comes back to the bit, the library reads and writes the same, damage is named."""

import json
import re
import struct

import numpy as np
import pytest

from bicycle_env.files import FileError, pack_arrays, read_arrays, unpack_arrays, write_arrays
from bicycle_env.files.arrays import DTYPES

RNG = np.random.default_rng(0)
ARRAYS = {
    **{f"a{name}": (RNG.normal(size=(2, 3)) * 50).astype(dtype) for name, dtype in DTYPES.items()},
    "scalar": np.array(3.5),
    "empty": np.zeros((0, 4), np.float32),
    "tr\u00e4ge": np.array([-0.0, 5e-324]),
}


def equal(first, second):
    assert set(first) == set(second)
    for name, array in first.items():
        assert array.dtype == second[name].dtype
        assert array.shape == second[name].shape
        assert array.tobytes() == second[name].tobytes()


def test_what_is_written_comes_back_to_the_bit(tmp_path):
    write_arrays(tmp_path / "x.safetensors", ARRAYS)
    back = read_arrays(tmp_path / "x.safetensors")
    equal(back, ARRAYS)
    for array in back.values():
        assert array.flags.writeable
        assert array.flags.c_contiguous


def test_the_order_in_memory_does_not_show():
    turned = {"a": np.asfortranarray(ARRAYS["aF32"]), "b": np.arange(6.0)[::2], "c": np.arange(3, dtype=">i4")}
    back = unpack_arrays(pack_arrays(turned), "x")
    for name, array in turned.items():
        assert np.array_equal(back[name], array)


def test_the_library_reads_and_writes_the_same_bytes():
    library = pytest.importorskip("safetensors.numpy")
    content = library.save(ARRAYS)
    assert pack_arrays(ARRAYS) == content
    equal(unpack_arrays(content, "x"), ARRAYS)
    equal(unpack_arrays(library.save(ARRAYS, {"origin": "x"}), "x"), ARRAYS)


@pytest.mark.parametrize("bad", [np.array(["a"]), np.array([1j]), np.array([None]), np.array(["2020"], "M8[Y]")])
def test_other_dtypes_are_not_written(bad):
    with pytest.raises(ValueError, match="'x' must have a dtype of U64, I64"):
        pack_arrays({"x": bad})


def packed(header, body=b"", length=None):
    words = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(words) if length is None else length) + words + body


def entry(dtype="F32", shape=(2,), offsets=(0, 8), **more):
    return {"dtype": dtype, "shape": list(shape), "data_offsets": list(offsets), **more}


BODY = np.array([1.0, 2.0], np.float32).tobytes()
NAN = np.array([1.0, np.nan], np.float32).tobytes()
BAD = [
    (b"", "at least 8 bytes, this has 0"),
    (b"1234567", "at least 8 bytes"),
    (packed(b"{}", length=2**64 - 1), "the header must fit"),
    (packed(b"{}", length=3), "the header must fit"),
    (packed(b" " * 1_000_001), "the header must fit into the file and 1000000 bytes"),
    (packed(b""), "the header: not JSON"),
    (packed(b"\x80\x04."), "the header: not JSON"),
    (packed(b"[1]"), "the header: the content must be a table, got a list"),
    (packed(b"[" * 1000), "the header: not JSON: nested deeper"),
    (packed(b'{"a": 1, "a": 2}'), "'a' stands twice"),
    (packed({"x": 3}), "'x' must be a table of dtype, shape, data_offsets, got a int"),
    (packed({"x": None}), "'x' must be a table"),
    (packed({"x": {"dtype": "F32"}}, BODY), "missing: 'shape', 'data_offsets'"),
    (packed({"x": entry(extra=1)}, BODY), "unknown key in 'x' 'extra'"),
    (packed({"x": entry("F8_E4M3")}, BODY), "'x'.dtype must be one of"),
    (packed({"x": entry("BF16")}, BODY), "'x'.dtype must be one of"),
    (packed({"x": entry(["F32"])}, BODY), "'x'.dtype must be one of"),
    (packed({"x": {**entry(), "shape": 2}}, BODY), "'x'.shape must be a list"),
    (packed({"x": entry(shape=(-2,))}, BODY), "'x'.shape[0] must be a whole number"),
    (packed({"x": entry(shape=(2.0,))}, BODY), "'x'.shape[0] must be a whole number"),
    (packed({"x": entry(shape=(True, 2))}, BODY), "'x'.shape[0] must be a whole number"),
    (packed({"x": entry(shape=(1,) * 17)}, BODY), "'x'.shape must have 0 to 16 entries"),
    (packed({"x": entry(shape=(2**40, 2**40))}, BODY), "'x' has 8 bytes, not those of F32"),
    (packed({"x": entry(shape=(3,))}, BODY), "'x' has 8 bytes, not those of F32 of shape [3]"),
    (packed({"x": entry("F64")}, BODY), "'x' has 8 bytes, not those of F64"),
    (packed({"x": entry(offsets=(0, 16))}, BODY), "'x' must begin at byte 0 of 8"),
    (packed({"x": entry(offsets=(8, 0))}, BODY), "'x' must begin at byte 0"),
    (packed({"x": entry(offsets=(-8, 0))}, BODY), "'x'.data_offsets[0] must be a whole number"),
    (packed({"x": entry(offsets=(0, 2**70))}, BODY), "'x'.data_offsets[1] must be a whole number"),
    (packed({"x": entry(offsets=(0, 8, 8))}, BODY), "'x'.data_offsets must have 2 to 2 entries"),
    (packed({"x": entry(offsets=(4, 12))}, BODY * 2), "'x' must begin at byte 0 of 16"),
    (packed({"x": entry(), "y": entry()}, BODY), "'y' must begin at byte 8"),
    (packed({"x": entry(), "y": entry(offsets=(4, 12))}, BODY * 2), "'y' must begin at byte 8"),
    (packed({"x": entry(), "y": entry(offsets=(12, 20))}, BODY * 3), "'y' must begin at byte 8"),
    (packed({"x": entry()}, BODY + b"\0"), "1 bytes belong to no array"),
    (packed({}, b"\0"), "1 bytes belong to no array"),
    (packed({"x": entry()}, BODY[:-1]), "'x' must begin at byte 0 of 7"),
    (packed({"x": entry()}, NAN), "'x' has values that are not finite"),
    (packed({"x": entry("BOOL", offsets=(0, 2))}, b"\1\2"), "'x' must hold 0 and 1"),
    (packed({"__metadata__": 3}), "__metadata__ must be a table"),
    (packed({"__metadata__": {"a": 3}}), "__metadata__.a must be a text"),
    (packed({"\x1b[31m": entry(shape=(3,))}, BODY), r"'\x1b[31m' has 8 bytes"),
]


@pytest.mark.parametrize(("content", "words"), BAD, ids=range(len(BAD)))
def test_damage_is_one_line_that_names_the_file(tmp_path, content, words):
    path = tmp_path / "x.safetensors"
    path.write_bytes(content)
    with pytest.raises(FileError, match=re.escape(words)) as caught:
        read_arrays(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert str(caught.value).isprintable()


def test_every_cut_of_a_file_is_refused():
    content = pack_arrays({"x": np.arange(3.0), "y": np.arange(2)})
    for length in range(len(content)):
        with pytest.raises(FileError):
            unpack_arrays(content[:length], "x")
