"""For all tests: Ctrl-C is not ignored, and tests/combinations.py can be imported from every folder of tests.

(pytest puts this file's folder on the path.)
"""

import signal
import threading


def pytest_configure():
    """A shell's background job ignores Ctrl-C, and so would the commands that the tests of stopping start."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)
