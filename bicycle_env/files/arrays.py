"""Arrays as data: the safetensors format, read and written with numpy alone.

A file is 8 bytes with the header's length, a JSON header (per array its dtype, shape and place), and the arrays' bytes.
See https://huggingface.co/docs/safetensors.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bicycle_env.files.reading import FileError, naming, parse_json, read_bytes
from bicycle_env.files.schema import listed, mapping, one_of, table, text, whole_in

LARGEST = 100_000_000  # bytes of a file
LARGEST_HEADER = 1_000_000
DTYPES: dict[str, np.dtype[Any]] = {  # in the order in which the library places them
    "U64": np.dtype("<u8"),
    "I64": np.dtype("<i8"),
    "F64": np.dtype("<f8"),
    "F32": np.dtype("<f4"),
    "U32": np.dtype("<u4"),
    "I32": np.dtype("<i4"),
    "F16": np.dtype("<f2"),
    "U16": np.dtype("<u2"),
    "I16": np.dtype("<i2"),
    "I8": np.dtype("i1"),
    "U8": np.dtype("u1"),
    "BOOL": np.dtype("?"),
}
NAMES = {dtype: name for name, dtype in DTYPES.items()}
METADATA = "__metadata__"
ENTRY = table(
    {
        "dtype": one_of(DTYPES),
        "shape": listed(whole_in(0, 2**48), most=16),
        "data_offsets": listed(whole_in(0, 2**48), 2, 2),
    }
)


def read_arrays(path: str | Path, largest: int = LARGEST) -> dict[str, NDArray[Any]]:
    """The arrays of a safetensors file by their names; each may be written to.

    Raises:
        FileError: no regular file, too large, or damaged: see :func:`unpack_arrays`.
        OSError: the file cannot be opened or read.
    """
    return unpack_arrays(read_bytes(path, largest), path)


def unpack_arrays(content: bytes, name: str | Path) -> dict[str, NDArray[Any]]:
    """The arrays in a safetensors file's content; nothing in it is executed.

    Args:
        content: what :func:`pack_arrays` or the safetensors library wrote.
        name: the file's, for errors.

    Raises:
        FileError: cut short; a header that is not JSON or not of this form; a dtype that numpy lacks; a size that is
            not the shape's; arrays that overlap, leave gaps or reach beyond the file; floats that are not finite.
    """
    with naming(name):
        if len(content) < 8:
            raise ValueError(f"a safetensors file has at least 8 bytes, this has {len(content)}")
        (length,) = struct.unpack("<Q", content[:8])
        if length > min(LARGEST_HEADER, len(content) - 8):
            raise ValueError(f"the header must fit into the file and {LARGEST_HEADER} bytes, claims {length}")
        try:
            header = parse_json(content[8 : 8 + length], "the header", mapping(lambda _, value: value), LARGEST_HEADER)
        except FileError as error:
            raise ValueError(str(error)) from None
        mapping(text(10_000))(METADATA, header.pop(METADATA, {}))
        entries = [(key, ENTRY(repr(key), entry)) for key, entry in header.items()]
        arrays: dict[str, NDArray[Any]] = {}
        place, size = 0, len(content) - 8 - length
        for key, entry in sorted(entries, key=lambda pair: pair[1]["data_offsets"]):
            (begin, end), dtype, shape = entry["data_offsets"], DTYPES[entry["dtype"]], entry["shape"]
            if begin != place or not begin <= end <= size:
                raise ValueError(f"{key!r} must begin at byte {place} of {size} and end there, has {begin} to {end}")
            if end - begin != math.prod(shape) * dtype.itemsize:
                raise ValueError(f"{key!r} has {end - begin} bytes, not those of {entry['dtype']} of shape {shape}")
            arrays[key] = _array(key, content[8 + length + begin : 8 + length + end], dtype, shape)
            place = end
        if place != size:
            raise ValueError(f"{size - place} bytes belong to no array")
        return {key: arrays[key] for key in header}


def _array(key: str, content: bytes, dtype: np.dtype[Any], shape: list[int]) -> NDArray[Any]:
    if dtype.kind == "b" and content.strip(b"\0\1"):
        raise ValueError(f"{key!r} must hold 0 and 1")
    array = np.frombuffer(content, dtype).reshape(shape).astype(dtype.newbyteorder("="))
    if dtype.kind == "f" and not np.all(np.isfinite(array)):
        raise ValueError(f"{key!r} has values that are not finite")
    return array


def pack_arrays(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """A safetensors file's content, byte for byte as the library writes it: ordered by dtype, then by name.

    Raises:
        ValueError: a dtype that the format lacks.
    """
    little = {key: np.asarray(array).dtype.newbyteorder("<") for key, array in arrays.items()}
    for key, dtype in little.items():
        if dtype not in NAMES:
            raise ValueError(f"{key!r} must have a dtype of {', '.join(DTYPES)}, got {np.asarray(arrays[key]).dtype}")
    header: dict[str, Any] = {}
    parts: list[bytes] = []
    place = 0
    for key in sorted(arrays, key=lambda key: (list(NAMES).index(little[key]), key)):
        parts.append(np.asarray(arrays[key], little[key]).tobytes())
        header[key] = {
            "dtype": NAMES[little[key]],
            "shape": list(np.shape(arrays[key])),
            "data_offsets": [place, place + len(parts[-1])],
        }
        place += len(parts[-1])
    words = json.dumps(header, separators=(",", ":"), ensure_ascii=False).encode()
    words += b" " * (-len(words) % 8)  # so the arrays' bytes are aligned
    return struct.pack("<Q", len(words)) + words + b"".join(parts)
