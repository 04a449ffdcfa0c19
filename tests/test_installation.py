"""The line that installs an extra, in a checkout and elsewhere."""

import sys
from pathlib import Path

import pytest

from bicycle_env import installation
from bicycle_env.control.design import symbolic


def test_in_a_checkout_and_for_an_installed_distribution(tmp_path, monkeypatch):
    assert installation.install_line("mpc") == 'pip install -c constraints.txt -e ".[mpc]"'
    monkeypatch.setattr(installation, "ROOT", tmp_path)
    assert installation.needs("This", "CasADi", "mpc") == 'This needs CasADi: pip install "bicycle-env[mpc]"'


def test_no_other_place_writes_the_line():
    package = Path(installation.__file__).parent
    found = [path.name for path in package.rglob("*.py") if "bicycle-env[" in path.read_text(encoding="utf-8")]
    assert found == ["installation.py"]


def test_a_missing_package_is_answered_with_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(ModuleNotFoundError) as caught:
        symbolic.casadi()
    assert str(caught.value) == 'model-predictive control needs CasADi: pip install -c constraints.txt -e ".[mpc]"'
