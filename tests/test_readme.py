"""The README says what is: its tables come from the results files, its code runs, its files exist."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from combinations import only_all

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def test_tables_are_those_of_the_results_files():
    changed = subprocess.run(["git", "diff", "--quiet", "HEAD", "--", "results"], cwd=ROOT, check=False).returncode
    if changed:
        pytest.skip("results/ holds results of your own: the README tells of the committed ones")
    tables = runpy.run_path(str(ROOT / "tools" / "readme_tables.py"))
    used = []
    for page in tables["PAGES"]:
        text = (ROOT / page).read_text(encoding="utf-8")
        assert tables["filled"](text) == text, f"{page}: run python tools/readme_tables.py"
        used += re.findall(r"<!-- results: (\w+) -->\n[|*]", text)
    assert set(used) == set(tables["TABLES"])


def test_the_first_line_says_automobile():
    assert "automobile" in TEXT.splitlines()[0]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_and_pictures_exist(page):
    for link in set(re.findall(r"\]\(((?!http)[^)#]+)[^)]*\)", page.read_text(encoding="utf-8"))):
        assert (page.parent / link).is_file(), link


def blocks(text):
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)


HELD_ELSEWHERE = ("export.md", "theory.md")
"""Pages whose lines another test runs, with what they say; gallery.md's cells are run when the site is built."""
FURTHER = [page for page in PAGES[1:] if page.name not in HELD_ELSEWHERE and "```python" in page.read_text("utf-8")]


FORKED = """
import os, sys
import gymnasium, numba, numpy, scipy.interpolate, scipy.linalg, scipy.signal  # slow, and imported by every block
assert "bicycle_env" not in sys.modules
for k, block in enumerate(sys.argv[1:]):
    if (child := os.fork()) == 0:
        os.mkdir(str(k))
        os.chdir(str(k))
        exec(compile(block, f"<block {k}>", "exec"), {"__name__": "__main__"})
        sys.exit()
    if os.waitpid(child, 0)[1] != 0:
        sys.exit(block)
"""


@pytest.mark.parametrize("page", [PAGES[0], *map(only_all, FURTHER)], ids=lambda page: page.name)
def test_code_runs(page, tmp_path):
    """Each block in a process and a folder of its own, where nobody has imported the package before it."""
    command = [sys.executable, "-W", "error", "-c", FORKED, *blocks(page.read_text(encoding="utf-8"))]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_commands_name_modules_that_exist():
    for module in set(re.findall(r"python -m (agents\.\w+)", TEXT)):
        assert (ROOT / (module.replace(".", "/") + ".py")).is_file()


def test_make_targets_exist():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^make ([a-z-]+)", TEXT, re.M)) | set(re.findall(r"`make ([a-z-]+)`", TEXT))
    assert targets >= {"demo", "test"}
    for target in targets:
        assert re.search(rf"^{target}:", makefile, re.M), target
