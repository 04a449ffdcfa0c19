# make demo, make test: from an empty machine with Python 3.11 or newer. Everything is installed into .venv.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
GYMNASIUM_VERSIONS := 1.1.1 1.2.2 1.4.0

.PHONY: help demo test test-all lint lane-change room benchmark benchmark-vector compat gymnasium-versions clean

help:
	@echo "make demo                train, compare with LQR, draw: results/demo.json and results/demo/*.png"
	@echo "make test                install what the tests need and run them: every rule and every option"
	@echo "make test-all            the combinations of options that make test leaves out"
	@echo "make lint                ruff and mypy"
	@echo "make lane-change         learn the lane change with five seeds: results/BicycleLaneChange-v0-ppo.json (6 minutes)"
	@echo "make room                what could be saved beside what controllers save: results/room.json, .png"
	@echo "make benchmark           speed beside CartPole and highway-env: results/single_env.json"
	@echo "make benchmark-vector    many cars at once, beside C and other libraries: results/vector_env.json (needs gcc)"
	@echo "make compat              Stable-Baselines3, RLlib, TorchRL, Minari, ...: results/compat.json (installs 6 GB)"
	@echo "make gymnasium-versions  contract checks on gymnasium $(GYMNASIUM_VERSIONS)"

$(VENV)/bin/python:
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'Python 3.11 or newer is needed, this is ' + sys.version)"
	$(PYTHON) -m venv $(VENV)

# One stamp per set of extras: installed once, and again when the requirements change.
$(VENV)/.installed-%: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e ".[$*]"
	@touch $@

demo: $(VENV)/.installed-demo
	$(BIN)/python -m agents.demo

test: $(VENV)/.installed-test
	$(BIN)/python -m pytest -n auto --dist worksteal

test-all: $(VENV)/.installed-test
	$(BIN)/python -m pytest -n auto --dist worksteal -m exhaustive

lint: $(VENV)/.installed-test
	$(BIN)/python -m ruff format --check .
	$(BIN)/python -m ruff check .
	$(BIN)/python -m mypy

lane-change: $(VENV)/.installed-demo
	$(BIN)/python -m agents.benchmark --env-id BicycleLaneChange-v0 --median-of-lqr 0.8 --worst-of-lqr 0.5

room: $(VENV)/.installed-demo
	$(BIN)/python -m agents.room --json results/room.json

benchmark: $(VENV)/.installed-bench
	$(BIN)/python benchmarks/single_env.py --json results/single_env.json

benchmark-vector: $(VENV)/.installed-bench
	$(BIN)/python benchmarks/vector_env.py --most 1000000 --json results/vector_env.json
	$(BIN)/python benchmarks/picture.py
	$(BIN)/python benchmarks/one_car.py --json results/one_car.json

compat: $(VENV)/.installed-test
	$(BIN)/python tools/compat.py

gymnasium-versions:
	@for version in $(GYMNASIUM_VERSIONS); do \
		echo "== gymnasium $$version"; \
		$(PYTHON) -m venv .venv-gymnasium-$$version && \
		grep -v '^gymnasium==' constraints.txt > .venv-gymnasium-$$version/constraints.txt && \
		.venv-gymnasium-$$version/bin/python -m pip install -q --disable-pip-version-check \
			-c .venv-gymnasium-$$version/constraints.txt -e ".[test]" "gymnasium==$$version" && \
		.venv-gymnasium-$$version/bin/python -m pytest -q -n auto tests/contracts || exit 1; \
	done

clean:
	rm -rf $(VENV) .venv-gymnasium-* .venv-compat-* build dist *.egg-info
