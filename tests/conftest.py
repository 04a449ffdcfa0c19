"""For all tests: Ctrl-C is not ignored, one thread each, tests/combinations.py can be imported from every folder.

(pytest puts this file's folder on the path.)
"""

import os
import signal
import threading

for library in ("OPENBLAS", "OMP"):  # before numpy and torch are imported; small problems, a process per core
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")


def pytest_configure():
    """A shell's background job ignores Ctrl-C, and so would the commands that the tests of stopping start."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)
