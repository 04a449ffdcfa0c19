"""Who may import whom: every module is parsed, imports inside functions included. See ROWS for the rules."""

import ast
import functools
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = "bicycle_env"
LONGEST_FILE = 400


class Row(NamedTuple):
    """What a layer may import: other layers, packages anywhere, and layers or packages inside functions only."""

    layers: set[str]
    packages: set[str]
    lazy_layers: set[str] = frozenset()
    lazy_packages: set[str] = frozenset()


BELOW_ENVS = {"tasks", "analysis", "simulation", "backends", "physics"}
EVERYTHING = {
    *BELOW_ENVS,
    "control",
    "envs",
    "wrappers",
    "rendering",
    "registration",
    "files",
    "provenance",
    "installation",
    "streams",
    "plots",
    "root",
}

ROWS = {
    "physics": Row({"files"}, {"numpy"}),
    "backends": Row({"physics", "files"}, {"numpy", "numba", "llvmlite"}),  # llvmlite: numba's own way to its compiler
    "simulation": Row({"physics", "backends"}, {"numpy", "numba"}),
    "physics.validation": Row(set(), set()),
    "files": Row(set(), {"numpy"}),
    "files.schema": Row({"physics"}, set()),  # of physics, the checks of values, which import nothing
    "provenance": Row(set(), set()),
    "streams": Row(set(), set()),
    "installation": Row(set(), set()),
    "analysis": Row(
        {"simulation", "backends", "physics", "installation"},
        {"numpy", "scipy", "numba"},
        lazy_packages={"control", "tqdm"},
    ),
    "tasks": Row({"analysis", "physics"}, {"numpy"}),
    "control": Row({*BELOW_ENVS, "files", "installation"}, {"numpy", "scipy", "numba"}, lazy_packages={"casadi"}),
    "envs": Row(
        {*BELOW_ENVS, "installation"},
        {"gymnasium", "numpy", "numba", "llvmlite"},
        lazy_layers={"rendering"},
        lazy_packages={"jax", "torch"},
    ),
    "rendering": Row(
        {*BELOW_ENVS, "files", "installation"},
        {"pygame", "numpy", "gymnasium"},
        lazy_packages={"PIL", "imageio_ffmpeg"},
    ),
    "wrappers": Row({*BELOW_ENVS, "envs", "files", "installation"}, {"gymnasium", "numpy"}),
    "wrappers.sb3_vec_env": Row(set(), {"gymnasium", "numpy", "stable_baselines3"}),  # imported when first named
    "plots": Row({*BELOW_ENVS, "files", "installation"}, {"numpy"}, lazy_packages={"matplotlib"}),
    "optimum": Row({*BELOW_ENVS, "control", "envs"}, {"gymnasium", "numpy"}),  # on top: no other row names it
    "export": Row(  # on top, imported by the command and explore alone
        {*BELOW_ENVS, "control", "envs", "files", "installation", "root"},
        {"numpy", "numba", "gymnasium"},
    ),
    "explore": Row(  # on top, imported by the command alone
        {"analysis", "control", "export", "files", "leaderboard", "physics", "plots", "report", "tasks"}, {"numpy"}
    ),
    "registration": Row(set(), {"gymnasium"}, lazy_layers={"envs"}),
    "root": Row(
        {"physics", "simulation", "analysis", "tasks", "registration"},
        set(),
        lazy_layers={"plots", "rendering", "control"},
    ),
    "play": Row({*BELOW_ENVS, "control", "files"}, {"gymnasium", "numpy"}, lazy_layers={"rendering"}),  # on top
    "play.human": Row({"control", "rendering"}, {"numpy"}),  # these two are imported when a window is opened
    "play.window": Row({"rendering", "play"}, {"numpy"}),
    "command_words": Row({"installation"}, set()),
    "leaderboard": Row({"files", "physics"}, set()),
    "report": Row(EVERYTHING | {"report"}, {"numpy", "scipy"}, lazy_packages={"matplotlib", "gymnasium", "control"}),
    "cli": Row(
        EVERYTHING | {"report", "leaderboard", "command_words"},
        set(),
        lazy_layers={"explore", "export", "play"},
        lazy_packages={"numpy", "gymnasium", "shtab"},
    ),
}


class Import(NamedTuple):
    module: str
    lazy: bool
    line: int


parsed = functools.cache(ast.parse)
"""A module's tree: several rules look at each."""


def imports_of(source, module=f"{PACKAGE}.some.module"):
    """Every imported module, or module.name for `from module import name`, and whether a function imports it."""
    found = []

    def visit(node, lazy):
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Import):
                found.extend(Import(alias.name, lazy, child.lineno) for alias in child.names)
            elif isinstance(child, ast.ImportFrom):
                base = child.module or ""
                if child.level:
                    base = ".".join([*module.split(".")[: -child.level], *([base] if base else [])])
                found.extend(Import(f"{base}.{alias.name}", lazy, child.lineno) for alias in child.names)
            visit(child, lazy or isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)))

    visit(parsed(source), False)
    return found


def layer_of(module):
    """``bicycle_env.physics.tires.Fiala`` is in "physics"; a name of ``bicycle_env`` itself is in "root"."""
    parts = module.split(".")
    if len(parts) == 1 or (parts[1] not in ROWS and not is_module(parts[1])):
        return "root"
    return parts[1]


def is_module(name):
    return (ROOT / PACKAGE / name).is_dir() or (ROOT / PACKAGE / f"{name}.py").is_file()


def violations(source, layer, module=f"{PACKAGE}.some.module"):
    """The imports of a module in a layer that break the rules, in words."""
    row, bad = ROWS[layer], []
    for found in imports_of(source, module):
        top = found.module.split(".")[0]
        if top == PACKAGE:
            target = layer_of(found.module)
            allowed = target == layer or target in row.layers or (found.lazy and target in row.lazy_layers)
        elif top in sys.stdlib_module_names:
            allowed = True
        else:
            allowed = top in row.packages or (found.lazy and top in row.lazy_packages)
        if not allowed:
            bad.append(f"line {found.line}: {layer} must not import {found.module}")
    return bad


def private_imports(source):
    """Imports of underscored modules or names of the package."""
    return [
        f"line {found.line}: {found.module} is private"
        for found in imports_of(source)
        if found.module.split(".")[0] == PACKAGE and any(part.startswith("_") for part in found.module.split(".")[1:])
    ]


def modules_under(*folders):
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def name_of(path):
    return path.relative_to(ROOT).as_posix()


def module_and_layer(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    layer = "root" if parts[1] == "__init__" else "cli" if parts[1] == "__main__" else parts[1]
    own = ".".join(parts[1:])
    return ".".join(parts), own if own in ROWS else layer


OURS = modules_under(PACKAGE)
OURS_AND_AGENTS = modules_under(PACKAGE, "agents")


def broken(rule, paths):
    """What a rule finds, by file, where it finds something."""
    found = {name_of(path): rule(path) for path in paths}
    return {name: faults for name, faults in found.items() if faults}


def test_imports_go_downwards():
    def rule(path):
        module, layer = module_and_layer(path)
        if layer not in ROWS:
            return [f"{layer} has no row in this test: say what it may import"]
        return violations(path.read_text(encoding="utf-8"), layer, module)

    assert broken(rule, OURS) == {}


def test_agents_use_public_names_only():
    assert broken(lambda path: private_imports(path.read_text(encoding="utf-8")), modules_under("agents")) == {}


def test_the_package_does_not_import_the_scripts():
    def rule(path):
        tops = {found.module.split(".")[0] for found in imports_of(path.read_text(encoding="utf-8"))}
        return tops & {"agents", "tests", "benchmarks", "tools"}

    assert broken(rule, OURS) == {}


def test_files_stay_short():
    lengths = {name_of(path): len(path.read_text(encoding="utf-8").splitlines()) for path in OURS_AND_AGENTS}
    assert {name: length for name, length in lengths.items() if length > LONGEST_FILE} == {}


def test_no_assert_statements():
    """python -O removes them."""

    def rule(path):
        tree = parsed(path.read_text(encoding="utf-8"))
        return [node.lineno for node in ast.walk(tree) if isinstance(node, ast.Assert)]

    assert broken(rule, OURS_AND_AGENTS) == {}


def test_the_layers_exist():
    """The rules above are about folders that are there, and found their files."""
    for layer in ("physics", "analysis", "tasks", "control", "envs", "rendering"):
        assert any(module_and_layer(path)[1] == layer for path in OURS), layer
    assert len(modules_under("agents")) > 0


@pytest.mark.parametrize(
    ("layer", "source"),
    [
        ("physics", "import scipy"),
        ("physics", "import scipy.linalg"),
        ("physics", "import gymnasium as gym"),
        ("physics", "from bicycle_env.analysis import stability"),
        ("physics", "from bicycle_env import analysis"),
        ("physics", "import bicycle_env"),
        ("physics", "from bicycle_env import Vehicle"),
        ("physics", "from ..analysis import stability"),
        ("physics", "def f():\n    import torch"),
        ("physics", "class A:\n    def f(self):\n        if True:\n            from bicycle_env.tasks import task"),
        ("analysis", "import control"),
        ("analysis", "from control import TransferFunction"),
        ("analysis", "from bicycle_env.tasks.task import Task"),
        ("analysis", "def f():\n    import matplotlib"),
        ("tasks", "from bicycle_env.envs import kernels"),
        ("tasks", "import gymnasium"),
        ("control", "from bicycle_env.envs.single.single_track_env import SingleTrackEnv"),
        ("control", "def f():\n    from bicycle_env import envs"),
        ("control", "import gymnasium"),
        ("envs", "from bicycle_env.control.lqr import LQR"),
        ("envs", "def f():\n    import bicycle_env.control"),
        ("envs", "from bicycle_env.rendering.viewer import Viewer"),
        ("envs", "import torch"),
        ("envs", "def f():\n    import stable_baselines3"),
        ("rendering", "from bicycle_env.envs import kernels"),
        ("rendering", "from bicycle_env.control import LQR"),
        ("rendering", "import matplotlib"),
        ("wrappers", "def f():\n    from bicycle_env.report import tables"),
        ("control", "from bicycle_env.optimum import tune"),
        ("envs", "def f():\n    from bicycle_env.export import plant"),
        ("cli", "from bicycle_env.export import command"),
        ("cli", "from bicycle_env import explore"),
        ("envs", "def f():\n    from bicycle_env.optimum import search_steering"),
        ("wrappers", "def f():\n    import stable_baselines3"),
        ("envs", "from bicycle_env.cli import main"),
        ("physics", "import numba"),
        ("physics", "from bicycle_env.backends import compiled"),
        ("tasks", "from bicycle_env.backends.compiled import NUMBA"),
        ("backends", "from bicycle_env.analysis import stability"),
        ("root", "import gymnasium"),
        ("root", "from bicycle_env import envs"),
    ],
)
def test_the_rules_catch(layer, source):
    assert violations(source, layer, f"{PACKAGE}.{layer}.module") != []


@pytest.mark.parametrize(
    ("layer", "source"),
    [
        ("backends", "import math\nimport numba\nimport numpy as np\nfrom bicycle_env.physics import tires"),
        ("physics", "import math\nimport numpy as np\nfrom bicycle_env.physics import tires"),
        ("physics", "from . import tires\nfrom .vehicle import Vehicle"),
        ("analysis", "import scipy.linalg\nfrom bicycle_env.physics.vehicle import Vehicle"),
        ("analysis", "def f():\n    import control"),
        ("envs", "def f():\n    import torch\n    from bicycle_env.rendering.viewer import Viewer"),
        ("control", "from bicycle_env.tasks.task import Task"),
        ("cli", "from bicycle_env import report, simulate, envs"),
        ("cli", "def f():\n    from bicycle_env.export import command"),
    ],
)
def test_the_rules_allow(layer, source):
    assert violations(source, layer, f"{PACKAGE}.{layer}.module") == []


@pytest.mark.parametrize(
    "source",
    [
        "from bicycle_env.physics import _private",
        "from bicycle_env._hidden import name",
        "import bicycle_env._hidden",
        "def f():\n    from bicycle_env.simulation import _pair",
    ],
)
def test_the_rule_for_agents_catches(source):
    assert private_imports(source) != []


def test_the_package_an_environment_and_the_command_are_light():
    program = (
        "import sys\n"
        "import gymnasium as gym\n"
        "import bicycle_env\n"
        "import bicycle_env.wrappers\n"
        "assert not {'bicycle_env.control', 'bicycle_env.export', 'bicycle_env.backends.trace'} & set(sys.modules)\n"
        "assert 'bicycle_env.explore' not in sys.modules\n"
        "bicycle_env.load_policy('BicycleStab-v0')\n"
        "bicycle_env.plots.episode\n"
        "gym.make('BicycleStab-v0')\n"
        "import bicycle_env.cli\n"
        "print(*sorted({part for name in sys.modules for part in (name, name.split('.')[0])}))\n"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    loaded = set(done.stdout.split())
    assert {"bicycle_env", "gymnasium", "numba", "numpy"} <= loaded
    assert not loaded & {
        "torch",
        "jax",
        "minari",
        "casadi",
        "stable_baselines3",
        "matplotlib",
        "pygame",
        "control",
        "tensorboard",
        "pandas",
        "tqdm",
        "scipy.interpolate",  # these take longer than the controllers themselves: imported where they are used
        "scipy.signal",
        "scipy.stats",
    }


def test_test_files_have_names_of_their_own():
    """pytest takes two of one name for one."""
    names = [path.name for path in (ROOT / "tests").rglob("test_*.py")]
    assert sorted(set(names)) == sorted(names)
