"""`make docs`: the site builds without a warning, asks no other host for anything, and ran what it shows."""

import html
import json
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from bicycle_env.registration import ENVIRONMENTS

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
NODE = shutil.which("node")
FETCHED_LINKS = {"stylesheet", "icon", "preload", "prefetch", "modulepreload", "manifest", "preconnect", "dns-prefetch"}
URL_IN_STYLE = re.compile(r"url\(\s*['\"]?([^'\")]+)|@import\s+['\"]([^'\"]+)")


class Page(HTMLParser):
    """What a page fetches when it is shown, and where its links go."""

    def __init__(self, text):
        super().__init__()
        self.resources, self.links, self.classes, self.alternatives = [], [], [], []
        self._in_style = False
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self._in_style = tag == "style"
        self.classes += (given.get("class") or "").split()
        self.resources += [given[name] for name in ("src", "poster", "data") if given.get(name)]
        self.resources += [part.split()[0] for part in (given.get("srcset") or "").split(",") if part.strip()]
        self.resources += urls(given.get("style") or "")
        if tag == "link" and FETCHED_LINKS & set((given.get("rel") or "").split()):
            self.resources.append(given["href"])
        if tag in ("image", "use"):
            self.resources += [given[name] for name in ("href", "xlink:href") if given.get(name)]
        if tag == "img":
            self.alternatives.append(given.get("alt"))
        if tag == "a" and given.get("href"):
            self.links.append(given["href"])

    def handle_data(self, data):
        if self._in_style:
            self.resources += urls(data)
        self._in_style = False


def urls(style):
    """What a style sheet fetches."""
    return [first or second for first, second in URL_IN_STYLE.findall(style)]


def leaves_or_misses(file, address):
    """Whether an address is not a file beside this one."""
    parts = urlsplit(address)
    if parts.scheme == "data" or (not parts.path and not parts.netloc):
        return False
    return bool(parts.scheme or parts.netloc) or not (file.parent / unquote(parts.path)).is_file()


def test_what_a_page_fetches_is_seen():
    page = Page(
        '<link rel="stylesheet" href="a.css"><link rel="next" href="b.html"><script src="https://x.org/c.js"></script>'
        '<style>@import "d.css"; p { background: url(e.png) }</style><p style="background: url(\'//x.org/f.png\')">'
        '<img src="g.png" srcset="h.png 2x, i.png 3x"><a href="https://x.org">j</a>'
    )
    assert page.resources == [
        *("a.css", "https://x.org/c.js", "d.css", "e.png", "//x.org/f.png", "g.png", "h.png", "i.png")
    ]
    assert page.links == ["https://x.org"]
    here = Path(__file__)
    assert leaves_or_misses(here, "https://x.org/c.js")
    assert leaves_or_misses(here, "//x.org/f.png")
    assert leaves_or_misses(here, "missing.png")
    assert not leaves_or_misses(here, "../docs/test_site.py?v=1#here")


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_are_kept_without_what_they_print(notebook):
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    for cell in cells:
        assert cell["metadata"] == {}
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            assert cell["execution_count"] is None


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The built site. What fails in a notebook or in the gallery is a warning, and warnings are errors."""
    pytest.importorskip("sphinx", reason="make docs installs what the site is built with")
    place = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", "-d", str(place / "doctrees")]
    command += ["-D", "nb_execution_mode=force"]  # what was run for `make docs` tells nothing about now
    done = subprocess.run(
        [*command, str(DOCS), str(place / "html")], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return place / "html"


@pytest.mark.exhaustive
def test_the_site_is_whole_and_asks_no_other_host(site):
    pages = {file: Page(file.read_text(encoding="utf-8")) for file in site.rglob("*.html")}
    for name in ("index", "two_wheeler", "trust", "theory", "api/bicycle_env.analysis", "explorer/index"):
        assert site / f"{name}.html" in pages
    for row in ENVIRONMENTS:
        assert f"{row.id}.gif" in (site / "environments" / f"{row.id}.html").read_text(encoding="utf-8")
    fetched = [(file, address) for file, page in pages.items() for address in page.resources]
    for file in site.rglob("*.css"):
        fetched += [(file, address) for address in urls(file.read_text(encoding="utf-8"))]
    assert len(fetched) > 100
    assert [(file.name, address) for file, address in fetched if leaves_or_misses(file, address)] == []
    within = [(file, link) for file, page in pages.items() for link in page.links if not urlsplit(link).scheme]
    assert [(file.name, link) for file, link in within if leaves_or_misses(file, link)] == []


@pytest.mark.exhaustive
def test_formulas_are_set_by_what_is_in_the_site(site):
    katex = pytest.importorskip("sphinxcontrib.katex")
    resources = Page((site / "theory.html").read_text(encoding="utf-8")).resources
    for name in ("katex.min.js", "auto-render.min.js", "katex.min.css"):
        assert any(urlsplit(address).path.endswith(name) for address in resources), name
    style = (DOCS / "_static" / "katex" / "katex.min.css").read_text(encoding="utf-8")
    assert f"KaTeX {katex.katex_version}," in style, (
        "style and fonts are of another version than the extension's script"
    )


SCRIPT = """
const fs = require("node:fs"), [library, formulas] = process.argv.slice(2), katex = require(library);
for (const [text, displayMode] of JSON.parse(fs.readFileSync(formulas))) {
  try { katex.renderToString(text, { displayMode, throwOnError: true }); }
  catch (error) { console.log(error.message); }
}
"""


@pytest.mark.exhaustive
@pytest.mark.skipif(NODE is None, reason="no node here")
def test_every_formula_is_understood(site, tmp_path):
    """In the browser one that is not is shown in red."""
    text = (site / "theory.html").read_text(encoding="utf-8")
    found = re.findall(r'class="math[^>]*>\s*(\\[(\[])(.*?)\\[)\]]\s*</', text, re.DOTALL)
    assert len(found) > 100
    (tmp_path / "script.cjs").write_text(SCRIPT)
    (tmp_path / "formulas.json").write_text(json.dumps([(html.unescape(each), kind == r"\[") for kind, each in found]))
    command = [NODE, "script.cjs", str(site / "_static" / "katex.min.js"), "formulas.json"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.exhaustive
@pytest.mark.parametrize("source", [DOCS / "gallery.md", *NOTEBOOKS], ids=lambda path: path.stem)
def test_what_is_run_shows_what_came_out(source, site):
    page = Page((site / source.relative_to(DOCS).with_suffix(".html")).read_text(encoding="utf-8"))
    pictures = [address for address in page.resources if address.endswith(".png")]
    if source.suffix == ".md":
        cells = re.findall(r"^```\{code-cell\}.*\n(?!:tags: \[remove-cell\])", source.read_text(encoding="utf-8"), re.M)
        assert len(pictures) == len(cells)
    assert len(pictures) >= 2
    assert page.classes.count("cell_output") >= 2
    assert all(words.startswith("Figure: ") for words in page.alternatives)
