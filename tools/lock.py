"""Hashed lock files, made and installed with pip alone.

    python tools/lock.py                    # make lock: resolve anew from pyproject.toml and constraints.txt
    python tools/lock.py --install test     # what make demo and make test do: into the Python that runs this

The locks fit CPython 3.11 on Linux x86-64; elsewhere --install takes the versions of constraints.txt, without hashes.
demo.txt and test.txt come from pip's ordinary index. That has torch for Linux with CUDA: torch-cuda.txt holds this
build and the packages of several GB that it needs. torch-cpu.txt holds the build for the CPU, which the results were
made with; it is taken where pip finds it (PyTorch's site tells how to let pip look there).
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
LOCKS = ROOT / "locks"
EXTRAS = ("demo", "test")
CUDA = re.compile(r"(nvidia|cuda)-.*|triton|torch")  # torch, and what its build for CUDA needs beside
BUILD = "setuptools>=77"  # builds the package itself, without a build environment that pip fills from the index
HEADER = "# Made by `make lock` for CPython 3.11 on Linux x86-64; see tools/lock.py.\n"


def requirements(extra: str) -> list[str]:
    """What the package and an extra need, extras that name the package's own extras opened."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    found = [*project["dependencies"], BUILD]
    waiting = [extra]
    while waiting:
        for line in project["optional-dependencies"][waiting.pop()]:
            own = re.fullmatch(rf"{project['name']}\[(.*)\]", line)
            if own:
                waiting += own[1].split(",")
            else:
                found.append(line)
    return found


def resolved(wanted: list[str], *options: str, ordinary: bool) -> dict[str, tuple[str, str]]:
    """Version and SHA-256 by name, as pip would install; `ordinary` leaves this machine's settings of pip out."""
    environment = dict(os.environ)
    if ordinary:
        environment = {name: value for name, value in environment.items() if not name.startswith("PIP_")}
        environment |= {"PIP_CONFIG_FILE": os.devnull}
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [sys.executable, "-m", "pip", "install", "--dry-run", "--ignore-installed", "--quiet", *options]
        command += ["--only-binary=:all:", "-c", str(ROOT / "constraints.txt"), "--report", str(report), *wanted]
        subprocess.run(command, check=True, env=environment)
        entries: list[dict[str, Any]] = json.loads(report.read_text(encoding="utf-8"))["install"]
    return {
        normal(entry["metadata"]["name"]): (
            entry["metadata"]["version"],
            entry["download_info"]["archive_info"]["hashes"]["sha256"],
        )
        for entry in entries
    }


def normal(name: str) -> str:
    """A package's name as indexes compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def lock(found: dict[str, tuple[str, str]]) -> str:
    """A requirements file with hashes."""
    lines = [f"{name}=={version} \\\n    --hash=sha256:{digest}\n" for name, (version, digest) in sorted(found.items())]
    return "".join([HEADER, *lines])


def torch() -> dict[str, tuple[str, str]]:
    """The build of torch that pip chooses with this machine's settings; of a version without its suffix (+cpu)."""
    pin = next(line for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").split() if "torch==" in line)
    ((version, digest),) = resolved([pin], "--no-deps", ordinary=False).values()
    return {"torch": (version.partition("+")[0], digest)}


def make() -> None:
    """Write the locks anew; torch-cpu.txt only where this machine's pip chooses a build for the CPU."""
    LOCKS.mkdir(exist_ok=True)
    cuda: dict[str, tuple[str, str]] = {}
    for extra in EXTRAS:
        found = resolved(requirements(extra), ordinary=True)
        cuda |= {name: entry for name, entry in found.items() if CUDA.fullmatch(name)}
        kept = {name: entry for name, entry in found.items() if not CUDA.fullmatch(name)}
        (LOCKS / f"{extra}.txt").write_text(lock(kept), encoding="utf-8")
    (LOCKS / "torch-cuda.txt").write_text(lock(cuda), encoding="utf-8")
    here = torch()
    if here["torch"] != cuda["torch"]:
        (LOCKS / "torch-cpu.txt").write_text(lock(here), encoding="utf-8")


def fits() -> bool:
    """Whether the locks are for this Python and this machine."""
    python = (platform.python_implementation(), *sys.version_info[:2])
    return python == ("CPython", 3, 11) and (platform.system(), platform.machine()) == ("Linux", "x86_64")


def commands(extra: str) -> list[list[str]]:
    """The arguments of pip that install the package with an extra into this Python."""
    if not fits() or extra not in EXTRAS:
        return [["-c", str(ROOT / "constraints.txt"), "-e", f"{ROOT}[{extra}]"]]
    on_cpu = lock(torch()) == (LOCKS / "torch-cpu.txt").read_text(encoding="utf-8")
    files = (f"{extra}.txt", "torch-cpu.txt" if on_cpu else "torch-cuda.txt")
    hashed = [["--require-hashes", "--no-deps", "-r", str(LOCKS / file)] for file in files]
    return [*hashed, ["--no-deps", "--no-build-isolation", "-e", str(ROOT)]]


def install(extra: str) -> None:
    """Install the package with an extra into this Python, from the locks where they fit."""
    print(f"installing what {extra} needs, quietly: some minutes where it is to be downloaded", flush=True)
    for arguments in commands(extra):
        pip(arguments)


def pip(arguments: list[str]) -> None:
    """Run pip install; exit with its code if it fails, which has said why."""
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *arguments]
    code = subprocess.run(command, check=False).returncode
    if code:
        sys.exit(code)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--install", metavar="EXTRA", help="install an extra, from the locks where they fit")
    extra = parser.parse_args().install
    known = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    if extra and extra not in known:
        parser.error(f"there is no extra {extra!r}; there are {', '.join(known)}")
    install(extra) if extra else make()


if __name__ == "__main__":
    main()
