"""Compilers and interpreters that may be there or not."""

import shutil
import subprocess

import pytest

GCC, NODE = shutil.which("gcc"), shutil.which("node")
FLAGS = ("-std=c99", "-Wall", "-Werror", "-ffp-contract=off")  # docs/export.md's; without -O2, for the same bits
needs_gcc = pytest.mark.skipif(GCC is None, reason="no gcc here")
needs_node = pytest.mark.skipif(NODE is None, reason="no node here")


def run(*command, folder):
    """Exit code and what was said."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def build(folder, *sources, name="program", more=()):
    """Compile; fails with the compiler's words."""
    code, words = run(GCC, *FLAGS, *more, *sources, "-o", name, "-lm", folder=folder)
    assert code == 0, words


def c_test(folder, name):
    """What the test that came with the source says."""
    build(folder, f"{name}.c", f"{name}_test.c")
    return run("./program", folder=folder)


def js_test(folder, name):
    return run(NODE, f"{name}_test.mjs", folder=folder)
