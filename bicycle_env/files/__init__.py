"""Files, in both directions: nothing is read into memory unchecked, and a kill leaves no half of a file behind.

Every reader takes regular files up to a size only, and answers damage with one line that names the file:
:class:`FileError` (a ValueError), or the operating system's own OSError where a file cannot be opened at all.
"""

from bicycle_env.files.arrays import pack_arrays, read_arrays, unpack_arrays
from bicycle_env.files.reading import FileError, naming, parse_json, read_bytes, read_json, read_table, read_toml
from bicycle_env.files.schema import Check, anything, listed, mapping, number_in, one_of, table, text, whole_in
from bicycle_env.files.words import shown
from bicycle_env.files.writing import (
    checked_output,
    checked_output_folder,
    remove_partial_files,
    write_arrays,
    write_bytes,
    write_json,
)
from bicycle_env.files.yaml import read_yaml

__all__ = [
    "Check",
    "FileError",
    "anything",
    "checked_output",
    "checked_output_folder",
    "listed",
    "mapping",
    "naming",
    "number_in",
    "one_of",
    "pack_arrays",
    "parse_json",
    "read_arrays",
    "read_bytes",
    "read_json",
    "read_table",
    "read_toml",
    "read_yaml",
    "remove_partial_files",
    "shown",
    "table",
    "text",
    "unpack_arrays",
    "whole_in",
    "write_arrays",
    "write_bytes",
    "write_json",
]
