"""Run what other libraries do with these environments, and write versions and outcomes: `python tools/compat.py`.

A library that is heavy or pins other versions has a virtual environment of its own, .venv-compat-NAME; the others run
in this one. Each check drives some hundred steps and compares, see tests/compat and tests/wrappers. What fails, or
cannot be installed, is written down with the last line of its error; then the exit code is 1.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

from bicycle_env import provenance
from bicycle_env.files import read_json, write_json

ROOT = Path(__file__).parent.parent
SCRIPTS = "tests/compat"
LONGEST = 1800  # seconds
SAID = "checked: "


class Library(NamedTuple):
    """What to install, what to run, and whose versions to write down."""

    command: tuple[str, ...]
    versions: tuple[str, ...]
    install: tuple[str, ...] = ()
    """Beside this package, in a virtual environment of its own; nothing: in the one that runs this."""
    unpinned: tuple[str, ...] = ()
    """Packages of constraints.txt that the library pins to another version."""


def tests(file: str) -> tuple[str, ...]:
    return ("-m", "pytest", "-q", "--no-header", f"tests/wrappers/{file}")


LIBRARIES = {
    "stable-baselines3": Library(tests("test_sb3_vec_env.py"), ("stable-baselines3", "torch")),
    "gymnasium-wrappers": Library(tests("test_gymnasium_vector_wrappers.py"), ("torch",)),
    "cleanrl-style": Library(tests("test_cleanrl_loop.py"), ("torch",)),
    "gymnasium-video": Library(
        (f"{SCRIPTS}/record_video.py",), ("moviepy", "pygame-ce"), ("moviepy==2.2.1", "pygame-ce")
    ),
    "minari": Library((f"{SCRIPTS}/minari_collector.py",), ("minari",), ("minari[create,hdf5]==0.5.4", "pillow")),
    "torchrl": Library((f"{SCRIPTS}/torchrl_rollout.py",), ("torchrl", "tensordict", "torch"), ("torchrl==0.14.1",)),
    "rl_zoo3": Library(
        (f"{SCRIPTS}/rl_zoo3_train.py",),
        ("rl_zoo3", "stable-baselines3", "torch"),
        ("rl_zoo3==2.9.2", "requests"),  # rl_zoo3.enjoy imports requests without asking for it
    ),
    "rllib": Library(
        (f"{SCRIPTS}/rllib_ppo.py",), ("ray", "torch"), ("ray[rllib]==2.60.0", "torch"), unpinned=("gymnasium",)
    ),
}
EVERYWHERE = ("bicycle-env", "gymnasium", "numpy", "numba")


def prepare(name: str, library: Library) -> str:
    """The Python to run with; installs what is missing. Raises CalledProcessError."""
    if not library.install:
        return sys.executable
    place = ROOT / f".venv-compat-{name}"
    python = str(place / "bin" / "python")
    if not Path(python).exists():
        run([sys.executable, "-m", "venv", str(place)])
    pins = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    kept = [pin for pin in pins if pin.partition("==")[0] not in library.unpinned]
    constraints = place / "constraints.txt"
    constraints.write_text("\n".join(kept) + "\n", encoding="utf-8")
    pip = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check"]
    run([*pip, "-c", str(constraints), *library.install, "-e", str(ROOT)])
    return python


def run(command: list[str]) -> str:
    """Standard output; CalledProcessError or TimeoutExpired if it did not go well."""
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=LONGEST)
    if done.returncode:
        raise subprocess.CalledProcessError(done.returncode, command[:3], done.stdout, done.stderr)
    return done.stdout


def versions(python: str, packages: tuple[str, ...]) -> dict[str, str]:
    program = (
        "import json, platform, sys\n"
        "from importlib.metadata import version\n"
        "print(json.dumps({'python': platform.python_version(), **{name: version(name) for name in sys.argv[1:]}}))"
    )
    found: dict[str, str] = json.loads(run([python, "-c", program, *EVERYWHERE, *packages]))
    return found


def what_was_checked(output: str) -> list[str]:
    """The lines that a script says it checked, or pytest's count."""
    lines = output.strip().splitlines()
    said = [line.removeprefix(SAID) for line in lines if line.startswith(SAID)]
    return said or [lines[-1].partition(" in ")[0]]


def last_line(error: subprocess.CalledProcessError | subprocess.TimeoutExpired) -> str:
    if isinstance(error, subprocess.TimeoutExpired):
        return f"no end after {LONGEST} s"
    lines = [line for line in f"{error.stdout}\n{error.stderr}".splitlines() if line.strip()]
    return lines[-1].replace(str(ROOT), ".") if lines else f"exit code {error.returncode}"


def check(library: Library, name: str, revision: str) -> dict[str, Any]:
    """One row of the results file."""
    row: dict[str, Any] = {"outcome": "not installed", "date": time.strftime("%Y-%m-%d"), "git": revision}
    try:
        python = prepare(name, library)
        row |= {"versions": versions(python, library.versions), "outcome": "failed"}
        row |= {"checked": what_was_checked(run([python, *library.command])), "outcome": "ok"}
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
        row["error"] = last_line(error)
    return row


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="append", choices=LIBRARIES, metavar="NAME", help=", ".join(LIBRARIES))
    parser.add_argument("--json", type=Path, default=ROOT / "runs" / "compat.json", help="where the outcomes go")
    options = parser.parse_args()
    revision = provenance.git_revision()
    results: dict[str, Any] = {"command": "make compat", "machine": provenance.machine(), "libraries": {}}
    if options.only and options.json.is_file():
        results["libraries"] = read_json(options.json)["libraries"]
    for name in options.only or LIBRARIES:
        row = results["libraries"][name] = check(LIBRARIES[name], name, revision)
        told = row.get("error") or "; ".join(row["checked"])
        print(f"{name:20s} {row['outcome']:14s} {told}", flush=True)
        write_json(options.json, results)
    return 0 if all(row["outcome"] == "ok" for row in results["libraries"].values()) else 1


if __name__ == "__main__":
    sys.exit(main())
