"""For all tests: Ctrl-C is not ignored, one thread each, tests/combinations.py can be imported from every folder.

(pytest puts this file's folder on the path.)
"""

import atexit
import gc
import os
import signal
import sys
import tempfile
import threading
import types

import pytest

for library in ("OPENBLAS", "OMP"):  # before numpy and torch are imported; small problems, a process per core
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")


if "PYTEST_XDIST_WORKER" not in os.environ:  # what JAX has compiled serves all workers: a training is ten seconds of it
    compiled = tempfile.TemporaryDirectory(prefix="jax-", ignore_cleanup_errors=True)
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", compiled.name)
else:
    atexit.register(os._exit, 0)  # after all that others have registered: to take all its objects apart takes seconds


def pytest_configure():
    """A shell's background job ignores Ctrl-C, and so would the commands that the tests of stopping start."""
    gc.disable()  # until pytest_collection_finish
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)


LATER = ("BicycleDoubleLaneChange-v0", "BicycleActiveSteer-v0", "BicycleEvade-v0")
"""Of these `make test` has pages, keywords, golden rollouts and published cases; the rest is in `make test-all`."""
AT_ONCE = ("test_env_documentation.py", "test_env_keywords.py", "test_golden_rollouts.py", "test_published_cases.py")
OF_THEM = (
    "test_active_steer.py",
    "test_double_lane_change.py",
    "test_evade.py",
    "test_evade_path.py",
    "test_plan_search.py",
    "test_rear_steering.py",
)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark what is left to `make test-all`: later ids; of parameters that multiply, all but one row for each value."""
    seen = set()
    for item in items:
        parameters = getattr(item, "callspec", None)
        values = [] if parameters is None else [getattr(each, "id", each) for each in parameters.params.values()]
        of_them = any(value in LATER for value in values if isinstance(value, str))
        if item.path.name in OF_THEM or (of_them and item.path.name not in AT_ONCE):
            item.add_marker(pytest.mark.exhaustive)
        if parameters is not None and item.get_closest_marker("exhaustive") is None:
            places = {(item.nodeid.partition("[")[0], *place) for place in enumerate(parameters._idlist)}
            if places <= seen:
                item.add_marker(pytest.mark.exhaustive)
            seen |= places


def pytest_collection_finish():
    """Libraries and tests are a million objects that stay: Python need not look through them for rings all the time."""
    gc.freeze()
    gc.enable()


@pytest.fixture
def interpreted(monkeypatch):
    """Environments without the compiler, for tests of what a law or a keyword says."""
    from interpreted import interpret

    interpret(monkeypatch)


@pytest.fixture
def films(monkeypatch):
    """What would be written by moviepy, whether it is there or not: (frames, fps) of each film."""
    written = []

    class Clip:
        def __init__(self, frames, fps):
            self.film = (list(frames), fps)

        def write_videofile(self, path, **_):
            written.append(self.film)

    for name in ("moviepy", "moviepy.video", "moviepy.video.io", "moviepy.video.io.ImageSequenceClip"):
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    sys.modules["moviepy.video.io.ImageSequenceClip"].ImageSequenceClip = Clip
    return written
