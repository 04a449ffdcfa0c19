"""Count the lines of tasks/, envs/ and backends/, at a revision and here: `python tools/line_count.py [revision]`.

What had no counterpart at the first revision is counted by its own name. `FEATURES` and `TASKS` list what is theirs
alone: files ("*"); classes, functions, fields and local variables, with the string below them and the blank lines
after them; and, as `function:word`, the statements of a function that name the word. An import is a feature's where
only its lines use it. All else is the same code.
"""

from __future__ import annotations

import ast
import functools
import io
import subprocess
import sys
import tarfile
from collections.abc import Iterator, Mapping
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGE = "bicycle_env"
BEFORE = "179dd3a"
FOLDERS = ("tasks/", "envs/", "backends/")
MOVED = ("physics/compiled.py", "physics/announcements.py", "physics/compile_cache.py")
"""What backends/ was at the first revision."""
PAGES = "pages of the environments"
ARGUMENTS = "envs/arguments.py"
"""Rows that all pages have."""
SAME = "the same code"
GENERICS = {"envs/blocks.py": "columns store", "envs/torch_kernels.py": "mapped chosen"}
"""At the first revision; the first two are in physics/records.py now, which is outside of the folders."""

Names = Mapping[str, str]
"""By file: "*" for all of it, or names, or function:word."""
TASKS: dict[str, Names] = {
    "double lane change": {"tasks/double_lane_change.py": "*", "envs/bicycle_double_lane_change.py": "*"},
    "active steer": {
        **dict.fromkeys(("tasks/active_steer.py", "tasks/fmvss126.py", "tasks/steadiness.py", "tasks/twin.py"), "*"),
        "envs/bicycle_active_steer.py": "*",
    },
    "evasion": {"tasks/evade.py": "*", "envs/bicycle_evade.py": "*"},
    "what the last two draw": {"tasks/draws.py": "*"},
}
FEATURES: dict[str, Names] = {
    "generics": {"envs/tensors/tensor_kernels.py": "mapped chosen"},
    "JAX": {
        "envs/tensors/jax_env.py": "*",
        "envs/tensors/tensor_kernels.py": "Library tensor_kernels.spread tensor_kernels.code",
        "envs/tensors/torch_device.py": "torch_library",
    },
    "laws written out for other languages": {"backends/trace.py": "*"},
    "disturbances": {"tasks/disturbances.py": "*"},
    "drivers": {"tasks/drivers.py": "*", "tasks/task.py": "Task.undriven"},
    "drawn parameters": {
        "tasks/randomised.py": "*",
        "tasks/distributions.py": "*",
        "tasks/task.py": "Task.told",
        "envs/configuration.py": "configure.drawn configure.cars",
        "envs/many/vector_env.py": "SingleTrackVectorEnv._info:told SingleTrackVectorEnv.__init__:told",
        "envs/single/single_track_env.py": "SingleTrackEnv._info:told",
        "envs/tensors/torch_vector_env.py": "TorchVectorEnv._look:told",
    },
    "delays and histories of observations": {"tasks/delays.py": "*"},
    "sensors, noise": {
        "tasks/sensors.py": "*",
        "backends/compiled.py": "integer _double tables",
        "backends/single_precision.py": "_single_of",
    },
    "tasks made of tasks": {"tasks/altered.py": "*", "tasks/options.py": "*", "envs/setup.py": "ADDED"},
    "tasks of one's own: registered, checked, explained": {
        "tasks/checking.py": "*",
        "tasks/__init__.py": "*",
        "tasks/path.py": "follows_path",
        "tasks/task.py": "NEEDED Task.__new__ Task.seconds_to_pass Task.forfeits",
        "envs/agreement.py": "*",
        "envs/telemetry.py": "columns check_metrics",
        "envs/registered_tasks.py": "*",
        "envs/setup.py": "OF_MAKERS check_names",
        "envs/origin.py": "OF_MANY ELSEWHERE check_levels _changed:ELSEWHERE _changed:check_names",
        "envs/plain.py": "UnwritableSpec _is_own plain_spec:_is_own",
        "envs/configuration.py": "configure:check configure:check_reward",
        "backends/compiled.py": "LawError REMEDIES _in_one_line",
        "envs/many/block_kernels.py": "_named",
    },
    "levels": {
        "tasks/task.py": "Task.levels Task.defaults",
        "tasks/lane_change.py": "LaneChange.levels",
        "tasks/stabilise.py": "Stabilise.levels",
        "envs/origin.py": "Origin.of_level origin_of.level origin_of.usual origin_of.made _level _over",
        "envs/setup.py": "Setup.level",
        "envs/configuration.py": "Configuration.level Configured.level",
        "envs/fleet.py": "Fleet.scored_level ConfiguredFleet.scored_level",
        "envs/single/single_track_env.py": "SingleTrackEnv.scored_level",
    },
    "figures of an episode": {
        "tasks/metrics.py": "*",
        "tasks/task.py": "Task.metrics",
        "tasks/lane_change.py": "LaneChange.metrics overshoot settling_time",
    },
    "pictures of many cars": {"envs/many/drawn_rows.py": "*"},
    "pictures of a task": {"tasks/marks.py": "*", "tasks/task.py": "History Task.histories Task.marks"},
    "a task's own command, conditions, memory, companions, end, success, cost": {
        "tasks/task.py": (
            "Task.settled_seconds Task.flipped Task.usual_speed Task.command Task.conditions Task.remember "
            "Task.companions Task.accompany Task.refilled Task.end Task.success Task.cost"
        ),
        "tasks/control_step.py": (
            "GRIP NO_GRIP Parts.accompany parts.pushed parts.command_law parts.moment parts.remember_law command_of "
            "car_of_the_moment _remember _accompany _beside transition.beside"
        ),
        "envs/many/blocks.py": "Access.keep_task_state keeper companions",
        "envs/many/block_kernels.py": (
            "_step.beside _step.step:beside _step.step.elapsed measuring.moment measuring.measure.now "
            "measuring.measure.episode"
        ),
        "envs/many/rows.py": "Rows.refill",
        "envs/many/vector_env.py": "SingleTrackVectorEnv.reset:refill",
        "envs/single/single_track_env.py": "SingleTrackEnv._refill SingleTrackEnv.reset:_refill",
        "envs/tensors/torch_vector_env.py": "TorchVectorEnv.reset:refill",
        "envs/tensors/tensor_kernels.py": (
            "TensorKernels.refill tensor_kernels.refill tensor_kernels.changing tensor_kernels.moment "
            "tensor_kernels.start_of_step tensor_kernels.substep:accompany tensor_kernels.step.body:changing "
            "tensor_kernels.measure.now"
        ),
    },
    "rewards, limits and tolerances as objects": {
        "tasks/rewards.py": (
            "Reward LAWS resolve _check_weights Bounded.name Bounded.__post_init__ Quadratic.name "
            "Quadratic.uses_horizon Quadratic.__post_init__"
        ),
        "tasks/ends.py": "_AboveZero",
        "tasks/task.py": "Task.limits Task.tolerances",
        "tasks/control_step.py": "parts.reward_law parts.before_law _before _with_forfeit",
        "envs/configuration.py": "Configuration.costs",
    },
    "corridors of any shape, clearance": {
        "tasks/ends.py": "end_outside clearance _point _pair _least",
        "tasks/task.py": "Task.uniform_corridor Task.judged_points",
        "tasks/episode.py": "Reference.road_half_width",
        "envs/telemetry.py": "MOMENT",
        "envs/many/block_kernels.py": "measuring.keep_rest measuring.clearance_law measuring.measure.clear",
    },
    "the model as an object": {"envs/configuration.py": "Configuration.tire Configuration.geometry Configured.model"},
    "relaxation length": {
        "envs/setup.py": "Setup.relaxation_length",
        "envs/configuration.py": (
            "Configuration.relaxation_length Configuration.State Configuration.linear_model.length "
            "Configuration.linear_model.names Configured.relaxation_length configure.relaxed "
            "configure.relaxation_length"
        ),
        "envs/fleet.py": "Fleet.relaxation_length configure_fleet.relaxation_length",
        "envs/tensors/tensor_kernels.py": "TensorKernels.complete tensor_kernels.completed",
    },
    "other cars by the options of reset": {
        "envs/origin.py": "Origin",
        "envs/fleet.py": "CAR_OPTIONS with_options Fleet.origin",
        "envs/many/rows.py": "Rows.put_cars Rows.cars checked_cars VectorSnapshot.names",
        "envs/many/vector_env.py": (
            "SingleTrackVectorEnv.reset.others SingleTrackVectorEnv.reset:_changed SingleTrackVectorEnv._fits:names "
            "SingleTrackVectorEnv.__init__._changed SingleTrackVectorEnv.restore:_changed"
        ),
        "envs/single/single_track_env.py": (
            "Snapshot.names Snapshot.driven SingleTrackEnv.present SingleTrackEnv._drive SingleTrackEnv.reset:cars "
            "SingleTrackEnv.reset.driven SingleTrackEnv.reset:_drive SingleTrackEnv.restore:driven "
            "SingleTrackEnv.snapshot.names SingleTrackEnv.snapshot.other"
        ),
        "envs/tensors/torch_vector_env.py": (
            "TorchSnapshot.cars TorchVectorEnv._cars TorchVectorEnv._copy_cars TorchVectorEnv._put_cars "
            "TorchVectorEnv.reset:cars TorchVectorEnv.reset:others TorchVectorEnv.__init__._changed "
            "TorchVectorEnv.snapshot.cars TorchVectorEnv.restore:cars TorchVectorEnv.__setstate__:_copy_cars"
        ),
    },
    "what a search may plan with, the hidden apart": {
        "tasks/task.py": "Task.hidden",
        "envs/many/rows.py": "Rows.mixed",
        "envs/many/vector_env.py": "SingleTrackVectorEnv.mixed",
    },
    "actions that are repeated": {
        "envs/setup.py": "Setup.action_repeat",
        "envs/configuration.py": (
            "MOST_REPEAT Configuration.action_repeat Configuration.action_timestep Configured.action_repeat "
            "Configured.action_timestep configure.action_repeat"
        ),
        "envs/single/single_track_env.py": "SingleTrackEnv._step_repeated SingleTrackEnv._steps",
        "envs/many/vector_env.py": "SingleTrackVectorEnv._run_repeated SingleTrackVectorEnv._drive",
        "envs/tensors/torch_vector_env.py": "TorchVectorEnv.step:action_repeat",
    },
    "success in every info": {
        "envs/many/block_kernels.py": "_step.step:success _step.step.steps_to_settle",
        "envs/many/blocks.py": "SharedLayout.steps_to_settle",
    },
    "laws compiled without machine code of their own": {
        "backends/part.py": "*",
        "backends/compiled.py": "entry_point:bind_environments",
    },
    "code compiled once for equal contents": {"backends/compiled.py": "PARTS ENTRY_POINTS _without_collecting"},
}


def sources(revision: str | None) -> dict[str, str]:
    """Text by path within the package, at a revision or, for None, here."""
    if revision is None:
        found = {str(path.relative_to(ROOT / PACKAGE)): path.read_text() for path in (ROOT / PACKAGE).rglob("*.py")}
    else:
        archive = subprocess.run(
            ["git", "archive", revision, PACKAGE], cwd=ROOT, check=True, capture_output=True
        ).stdout
        with tarfile.open(fileobj=io.BytesIO(archive)) as files:
            texts = {name: files.extractfile(name) for name in files.getnames() if name.endswith(".py")}
            found = {name.partition("/")[2]: file.read().decode() for name, file in texts.items() if file is not None}
    return {path: text for path, text in sorted(found.items()) if path.startswith(FOLDERS) or path in MOVED}


def _names(node: ast.stmt) -> list[str]:
    """What a statement defines."""
    if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
        return [node.name]
    targets = (
        getattr(node, "targets", [])
        if isinstance(node, ast.Assign)
        else [node.target]
        if isinstance(node, (ast.AnnAssign, ast.AugAssign))
        else []
    )
    parts = [part for target in targets for part in (target.elts if isinstance(target, ast.Tuple) else [target])]
    return [part.id if isinstance(part, ast.Name) else getattr(part, "attr", "") for part in parts]


def _text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


parsed = functools.cache(ast.parse)


def definitions(text: str) -> Iterator[tuple[str, set[int]]]:
    """(qualified name, lines) of all that a source defines, at any depth."""
    lines = text.splitlines()

    def inside(body: list[ast.stmt], prefix: str) -> Iterator[tuple[str, set[int]]]:
        for k, node in enumerate(body):
            first = min([node.lineno, *(one.lineno for one in getattr(node, "decorator_list", ()))])
            documented = _names(node) and k + 1 < len(body) and _text(body[k + 1])
            last = (body[k + 1] if documented else node).end_lineno or node.lineno
            while last < len(lines) and not lines[last].strip():
                last += 1
            for name in _names(node):
                yield f"{prefix}{name}", set(range(first, last + 1))
            heads = (
                [getattr(node, field, None) for field in ("test", "iter", "target")]
                if hasattr(node, "body")
                else [node]
            )
            for word in _named(*(head for head in heads if isinstance(head, ast.AST))):
                yield f"{prefix[:-1]}:{word}", set(range(first, last + 1))
            deeper = f"{prefix}{node.name}." if isinstance(node, (ast.FunctionDef, ast.ClassDef)) else prefix
            for part in ("body", "orelse", "finalbody"):
                yield from inside(getattr(node, part, []), deeper)

    return inside(parsed(text).body, "")


def lines_of(text: str, names: str) -> set[int]:
    """The lines of some names; KeyError for one that the source does not define."""
    if names == "*":
        return set(range(1, len(text.splitlines()) + 1))
    found = _by_name(text)
    return set().union(*(found[name] for name in names.split()))


@functools.cache
def _by_name(text: str) -> dict[str, set[int]]:
    found: dict[str, set[int]] = {}
    for name, lines in definitions(text):
        found.setdefault(name, set()).update(lines)
    return found


def _named(*nodes: ast.AST) -> set[str]:
    """The words that are named in some nodes."""
    parts = [part for node in nodes for part in ast.walk(node)]
    words = {getattr(part, field, None) for part in parts for field in ("id", "attr", "arg")}
    return {word for word in words if isinstance(word, str)}


def page(path: str, text: str) -> set[int]:
    """The lines of what users read of an environment: the docstrings of the classes, and what makes tables of them."""
    if path == ARGUMENTS:
        return lines_of(text, "*")
    classes = [node for node in parsed(text).body if isinstance(node, ast.ClassDef) and node.name.endswith("Env")]
    strings = [one.body[0] for one in classes if path.startswith("envs/") and _text(one.body[0])]
    return {line for one in strings for line in range(one.lineno, (one.end_lineno or one.lineno) + 1)}


def imports(text: str, own: set[int]) -> set[int]:
    """The lines of the imports that only these lines use."""
    tree = parsed(text)
    places: dict[str, set[int]] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            places.setdefault(node.id, set()).add(node.lineno)
    found: set[int] = set()
    for node in tree.body:
        if isinstance(node, (ast.Import, ast.ImportFrom)) and getattr(node, "module", "") != "__future__":
            names = {(one.asname or one.name).partition(".")[0] for one in node.names}
            used = set().union(*(places.get(name, set()) for name in names))
            if used and used <= own:
                found |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return found


@functools.cache
def code(text: str) -> set[int]:
    """The lines that are neither blank, nor comments, strings that explain, nor imports."""
    found = {k for k, line in enumerate(text.splitlines(), 1) if line.strip() and not line.strip().startswith("#")}
    for node in ast.walk(parsed(text)):
        if isinstance(node, (ast.Import, ast.ImportFrom)) or (isinstance(node, ast.stmt) and _text(node)):
            found -= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return found


def count(texts: Mapping[str, str], table: Mapping[str, Names]) -> dict[str, tuple[int, int]]:
    """Lines, and those of them that are code, by what they are for; each line once."""
    counts: dict[str, list[tuple[int, int]]] = {name: [] for name in (SAME, PAGES, *table)}
    for path, text in texts.items():
        left = lines_of(text, "*") - page(path, text)
        parts = {PAGES: lines_of(text, "*") - left}
        for feature, names in table.items():
            own = left & lines_of(text, names[path]) if path in names else set()
            own |= left & imports(text, own) if own else set()
            parts[feature], left = own, left - own
        for name, lines in {**parts, SAME: left}.items():
            counts[name].append((len(lines), len(lines & code(text)) if lines else 0))
    return {name: (sum(every for every, _ in each), sum(some for _, some in each)) for name, each in counts.items()}


def main() -> None:
    revision = sys.argv[1] if len(sys.argv) > 1 else BEFORE
    before, now = count(sources(revision), {"generics": GENERICS}), count(sources(None), {**FEATURES, **TASKS})
    print(f"{'':74}{'lines':>13}{'of them code':>20}")
    print(f"{'':74}{revision[:7]:>7}{'here':>8}{revision[:7]:>10}{'here':>8}")
    for name in now:
        (lines, some), (lines_now, some_now) = before.get(name, (0, 0)), now[name]
        print(f"{name:74}{lines:7,}{lines_now:8,}{some:10,}{some_now:8,}")
    every = [sum(each[k] for each in counts.values()) for k in (0, 1) for counts in (before, now)]
    print(f"{'all':74}{every[0]:7,}{every[1]:8,}{every[2]:10,}{every[3]:8,}")


if __name__ == "__main__":
    main()
