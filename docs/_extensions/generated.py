"""What the site has beside docs/*.md, made from the package when the site is built: an extension of Sphinx.

- ``environments/ID.md``: a page for each id, from its class's docstring, with its levels and a moving picture;
- ``api/*.rst``: the reference of the public names;
- ``explorer/`` in the built site: the page of ``bicycle-env explore``.

The first two are written into docs/, where git ignores them, because Sphinx reads pages from there only.
"""

from __future__ import annotations

import importlib
import inspect
import re
import runpy
import sys
import types
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
from docutils import nodes
from gymnasium.envs.registration import load_env_creator
from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer
from sphinx.util import logging

from agents import moving_picture
from agents.episodes import start_seeds
from bicycle_env import control, explore
from bicycle_env.files import write_bytes
from bicycle_env.registration import ENVIRONMENTS

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
LITERAL = re.compile(r"(``.*?``)")
LOG = logging.getLogger(__name__)

DRIVERS = {
    "BicycleStab-v0": ("zero", "lqr"),
    "BicycleLaneChange-v0": ("zero", "lqr"),
    "BicycleDoubleLaneChange-v0": ("preview", "lqr"),
    "BicycleActiveSteer-v0": ("zero", "rear-switched", "pretrained"),
    "BicycleEvade-v0": ("evade-path", "pretrained"),
}
"""Who drives in the picture of an id: nobody ("zero"), a classical law, the policy that ships."""
STARTS, SEED = 200, 1
"""Of which the picture shows the one that ``agents.moving_picture`` chooses by its rule."""

MODULES = (
    *("bicycle_env", "bicycle_env.analysis", "bicycle_env.tires", "bicycle_env.plots", "bicycle_env.envs"),
    *("bicycle_env.wrappers", "bicycle_env.control", "bicycle_env.tasks", "bicycle_env.rewards"),
    *("bicycle_env.disturbances", "bicycle_env.drivers", "bicycle_env.distributions", "bicycle_env.optimum"),
    *("bicycle_env.play", "bicycle_env.report", "bicycle_env.export", "bicycle_env.explore"),
)


def write_page(path: Path, text: str) -> None:
    """Write a page, unless it is there already: Sphinx builds anew what is newer."""
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        write_bytes(path, text.encode())


# The environments


def environments(app: Sphinx) -> None:
    """Write the page and the picture of each id."""
    levels = runpy.run_path(str(ROOT / "tools" / "readme_tables.py"))["levels"]().splitlines()
    for row in ENVIRONMENTS:
        picture = DOCS / "environments" / f"{row.id}.gif"
        if not newer(picture):
            LOG.info("drawing %s", picture.name)
            draw(row.id, picture)
        own = [line for line in levels[2:] if line.startswith(f"| `{row.id}` |")]
        table = "\n".join(line.replace(f"| `{row.id}` ", "", 1).replace("| id ", "", 1) for line in own)
        write_page(DOCS / "environments" / f"{row.id}.md", page(row.id, row.entry_point, table))


def newer(picture: Path) -> bool:
    """Whether a picture is there and was made after the last change of the code."""
    sources = [*(ROOT / "bicycle_env").rglob("*.py"), ROOT / "agents" / "moving_picture.py"]
    return picture.is_file() and picture.stat().st_mtime > max(source.stat().st_mtime for source in sources)


def draw(env_id: str, path: Path) -> None:
    env = gym.make(env_id)
    policies = {"nobody" if name == "zero" else name: control.make(name, env.unwrapped) for name in DRIVERS[env_id]}
    path.parent.mkdir(exist_ok=True)
    moving_picture.show(env_id, {}, policies, start_seeds(STARTS, SEED), path)


def page(env_id: str, entry_point: str, levels: str) -> str:
    """Markdown: the docstring under the picture, then the levels."""
    text = inspect.getdoc(load_env_creator(entry_point))
    summary, _, rest = text.partition("\n\n")
    drivers = " ".join(DRIVERS[env_id])
    command = f"python -m agents.moving_picture --env-id {env_id} --policy {drivers} --starts {STARTS} --seed {SEED}"
    return f"""# {env_id}

{summary}

![{env_id}: {", ".join(DRIVERS[env_id])} from the same start, seen from above]({env_id}.gif)

The same start for each of these policies; above the road, how many of {STARTS} starts each saves. `{command}`,
whose help says by which rule the start is chosen.

```py
env = gym.make("{env_id}")  # after import bicycle_env
```

{rest}

## Levels

As [levels.md](../levels.md) says for all ids:

| level | numbers |
|---|---|
{levels}
"""


# The reference


def reference(app: Sphinx) -> None:
    """Write a page for each module of public names, and the list of them."""
    elsewhere: dict[int, str] = {}
    for name in MODULES:
        write_page(DOCS / "api" / f"{name}.rst", module_page(name, elsewhere))
    listed = "\n".join(f"   {name}" for name in MODULES)
    write_page(DOCS / "api" / "index.rst", f"{title('Reference')}\n{ABOUT}\n.. toctree::\n\n{listed}\n")


ABOUT = """
The public names, by the module that they are imported from. What is not here may change without notice.
All numbers are in SI units, angles in rad; what a value must be, and what happens if it is not, stands with each name.
"""


def title(text: str) -> str:
    return f"{text}\n{'=' * len(text)}\n"


def module_of(name: str) -> types.ModuleType:
    """The module that stands under this name, such as ``bicycle_env.tires``, which lies elsewhere."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError:
        parent, _, own = name.rpartition(".")
        found: types.ModuleType = getattr(importlib.import_module(parent), own)
        return found


def public(module: types.ModuleType) -> list[str]:
    """Names of a module: those that it says are public, or what it defines."""
    said = getattr(module, "__all__", None)
    if said is not None:
        return [name for name in said if not name.startswith("_")]
    return [
        name
        for name, value in vars(module).items()
        if not name.startswith("_") and getattr(value, "__module__", None) == module.__name__
    ]


def module_page(name: str, elsewhere: dict[int, str]) -> str:
    """A list of the names, then each; `elsewhere` says, by id(), where a value stands already."""
    module = module_of(name)
    found = {each: getattr(module, each) for each in public(module)}
    modules = [f"{name}.{each}" for each, value in found.items() if isinstance(value, types.ModuleType)]
    values = {each: value for each, value in found.items() if not isinstance(value, types.ModuleType)}
    functions = {each: value for each, value in values.items() if callable(value)}
    lines = [title(name), inspect.getdoc(module) or "", ""]
    if modules:
        lines += [f"Its modules: {', '.join(f':doc:`{each}`' for each in modules)}.", ""]
    lines += [f".. currentmodule:: {name}", "", ".. autosummary::", "   :nosignatures:", ""]
    lines += [f"   {each}" for each in functions]
    for each, value in values.items():
        path = elsewhere.setdefault(id(value), f"{name}.{each}") if callable(value) else f"{name}.{each}"
        if path == f"{name}.{each}":
            lines += ["", *(entry(path, value) if callable(value) else data_entry(path, value))]
    return "\n".join([*lines, ""])


def entry(path: str, value: Any) -> list[str]:
    """The directive that documents a class or a function."""
    if not inspect.isclass(value):
        return [f".. autofunction:: {path}"]
    if issubclass(value, gym.Env) and hasattr(value, "default_task"):
        own = f"{value.__name__.removesuffix('Env')}-v0"
        return [f".. py:class:: {path}", "", f"   Its docstring is a page: :doc:`/environments/{own}`."]
    return [f".. autoclass:: {path}", "   :members:"]


def data_entry(path: str, value: Any) -> list[str]:
    """Of a value: the text below it where it is defined, and of a table its words."""
    lines = [f".. py:data:: {path}", f"   :type: {type(value).__name__}", ""]
    lines += [f"   {line}" for line in described(path.rpartition(".")[2], value)]
    if isinstance(value, (Mapping, tuple)) and all(isinstance(each, str) for each in value):
        lines += ["", f"   {', '.join(f'``{each}``' for each in value)}"]
    return lines


def described(name: str, value: Any) -> list[str]:
    """The text below the assignment that made a value, in whichever module that stands."""
    for module in [each for key, each in sys.modules.items() if key.startswith("bicycle_env.")]:
        if vars(module).get(name) is value:
            found = ModuleAnalyzer.for_module(module.__name__).find_attr_docs().get(("", name))
            if found:
                return found
    return []


def plain(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Docstrings as they are meant: |x| is an absolute value, and what dict says of itself says nothing of a table."""
    if "\n".join(lines).strip() == inspect.getdoc(dict):
        lines[:] = []
    for k, line in enumerate(lines):
        parts = LITERAL.split(line)
        lines[k] = "".join(part if part.startswith("``") else part.replace("|", r"\|") for part in parts)


# What is run


def named(app: Sphinx, doctree: nodes.document) -> None:
    """A picture that came out of a cell is called as the section where it stands, for whoever does not see it."""
    for image in doctree.findall(nodes.image):
        above = image.parent
        while above is not None and not isinstance(above, nodes.section):
            above = above.parent
        if "alt" not in image and above is not None:
            image["alt"] = f"Figure: {above.next_node(nodes.title).astext()}"


# The explorer


def write_explorer(app: Sphinx, exception: Exception | None) -> None:
    if exception is None and app.builder.format == "html":
        explore.write(Path(app.outdir) / "explorer")


def linked(app: Sphinx, docname: str, source: list[str]) -> None:
    """Links that are right on GitHub and elsewhere here; and one to the explorer, which GitHub does not have."""
    for there, here in {"](../README.md)": "](index.md)", "](../CONTRIBUTING.md)": "](contributing.md)"}.items():
        source[0] = source[0].replace(there, here)
    if docname == "explore":
        head, _, rest = source[0].partition("\n\n")
        link = '<a class="reference external" href="explorer/index.html">Open it here</a>, or on your own machine:'
        source[0] = f"{head}\n\n{link}\n\n{rest}"


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("builder-inited", environments)
    app.connect("builder-inited", reference)
    app.connect("source-read", linked)
    app.connect("autodoc-process-docstring", plain, priority=100)  # before napoleon
    app.connect("doctree-read", named)
    app.connect("build-finished", write_explorer)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
