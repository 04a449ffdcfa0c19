"""For all tests: Ctrl-C is not ignored, one thread each, tests/combinations.py can be imported from every folder.

(pytest puts this file's folder on the path.)
"""

import os
import signal
import threading

import pytest

for library in ("OPENBLAS", "OMP"):  # before numpy and torch are imported; small problems, a process per core
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")


def pytest_configure():
    """A shell's background job ignores Ctrl-C, and so would the commands that the tests of stopping start."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)


LATER = ("BicycleDoubleLaneChange-v0", "BicycleActiveSteer-v0", "BicycleEvade-v0")
"""Ids that go through the contracts in `make test-all`; `make test` has their own tests, pages and keywords."""
AT_ONCE = ("test_env_documentation.py", "test_env_keywords.py")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    for item in items:
        parameters = getattr(item, "callspec", None)
        if parameters is None or item.path.name in AT_ONCE or item.path.parent.name not in ("contracts", "wrappers"):
            continue
        values = [getattr(value, "id", value) for value in parameters.params.values()]
        if any(value in LATER for value in values if isinstance(value, str)):
            item.add_marker(pytest.mark.exhaustive)
