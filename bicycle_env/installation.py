"""How to install what an optional part of the package needs."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[1]


def install_line(extra: str) -> str:
    """The command for an extra: in a checkout, from its folder; otherwise for the distribution that is installed."""
    checkout = (ROOT / "pyproject.toml").is_file()
    return f'pip install -c constraints.txt -e ".[{extra}]"' if checkout else f'pip install "bicycle-env[{extra}]"'


def needs(what: str, package: str, extra: str) -> str:
    """One line for a ModuleNotFoundError: what needs which package, and how to install it."""
    return f"{what} needs {package}: {install_line(extra)}"
