"""The page with two presets, made once, and written into a folder."""

import pytest

from bicycle_env.explore import page

PRESETS = ("oversteer", "civic")


@pytest.fixture(scope="session")
def files():
    return page(PRESETS, served=True)


@pytest.fixture(scope="session")
def folder(files, tmp_path_factory):
    found = tmp_path_factory.mktemp("page")
    for name, content in files.items():
        (found / name).write_bytes(content)
    return found
