# make demo, make test: from an empty machine with Python 3.11 or newer. Everything is installed into .venv.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Where results go. Only `make results` writes the tracked folder results/.
OUT ?= runs
CONTROLLERS := zero lqr lqr-continuous scheduled-lqr pole-placement lqg mpc preview stanley preview+speed-dependent \
	preview+sano preview+zero-sideslip preview+yaw-rate stanley+speed-dependent stanley+sano stanley+zero-sideslip \
	stanley+yaw-rate
GYMNASIUM_VERSIONS := 1.1.1 1.2.2 1.4.0

.PHONY: help demo test test-all test-browser lint docs lock stab lane-change controllers headroom mpc entry-speed entry-speed-learned alignment learning robustness scaling tensors results benchmark benchmark-vector compat rllib gymnasium-versions clean

help:
	@echo "make demo                train, compare with LQR, draw: runs/demo.json and runs/demo/ (pictures, one moving)"
	@echo "make test                install what the tests need and run them: every rule and every option"
	@echo "make test-all            the combinations of options that make test leaves out"
	@echo "make test-browser        the explorer in a Chromium that is installed here; a part of make test-all"
	@echo "make lint                ruff and mypy"
	@echo "make docs                the documentation as a site: build/docs/index.html (3 minutes, then 1)"
	@echo "make lock                resolve locks/*.txt anew from pyproject.toml and constraints.txt"
	@echo "make stab                learn to catch the car with ten seeds: runs/BicycleStab-v0-ppo.json"
	@echo "make lane-change         learn the lane change with five seeds: runs/BicycleLaneChange-v0-ppo.json (6 minutes)"
	@echo "make controllers         all classical controllers on both tasks: runs/controllers_*.json"
	@echo "make headroom            every id and level: controllers tuned for it, best found, bound: runs/headroom.json, .png (an hour)"
	@echo "make mpc                 planning ahead on the hard levels, told nothing, friction, the driver's future: runs/mpc.json (an hour)"
	@echo "make entry-speed         how fast drivers and LQR pass the double lane change: runs/entry_speed.json"
	@echo "make entry-speed-learned five seeds learn to pass it on each course, beside them in that file (an hour)"
	@echo "make alignment           does the reward ask for what success judges: runs/alignment.json, .png (10 minutes)"
	@echo "make learning            every learner on every id and level, ablations: runs/benchmark.json, .png, ablations.json, ... (hours; goes on where it stopped)"
	@echo "make robustness          what the policies that ship bear, beside classical controllers: runs/robustness-*.json, .png (half an hour)"
	@echo "make scaling             trainings side by side, from one to the cores: runs/scaling.json (minutes; on a quiet machine)"
	@echo "make benchmark           speed beside CartPole and highway-env: runs/single_env.json"
	@echo "make benchmark-vector    many cars at once, beside C and other libraries: runs/vector_env.json (needs gcc)"
	@echo "make tensors             TorchVectorEnv beside the native environment: runs/torch_env.json"
	@echo "make results             all of these into results/, and the tables and pictures of the README and docs/ (hours)"
	@echo "make compat              Stable-Baselines3, RLlib, TorchRL, Minari, ...: runs/compat.json (installs 6 GB)"
	@echo "make rllib               Ray RLlib in an environment of its own: two runners train until the return has risen (1 GB)"
	@echo "make gymnasium-versions  contract checks on gymnasium $(GYMNASIUM_VERSIONS)"

$(VENV)/bin/python:
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'Python 3.11 or newer is needed, this is ' + sys.version)"
	$(PYTHON) -m venv $(VENV)

# One stamp per set of extras: installed once, and again when the requirements change. From hashed locks where they fit.
$(VENV)/.installed-%: pyproject.toml constraints.txt $(wildcard locks/*.txt) | $(VENV)/bin/python
	$(BIN)/python tools/lock.py --install $*
	@touch $@

lock:
	$(PYTHON) tools/lock.py

demo: $(VENV)/.installed-demo
	$(BIN)/python -m agents.demo --out $(OUT)

# The tests start many processes: each module is compiled once, whatever the shell has asked for.
test test-all: export PYTHONDONTWRITEBYTECODE :=

test: $(VENV)/.installed-test
	$(BIN)/python -m pytest -n auto --dist loadfile

test-all: $(VENV)/.installed-test $(VENV)/.installed-docs
	$(BIN)/python -m pytest -n auto --dist worksteal -m exhaustive

test-browser: $(VENV)/.installed-test
	$(BIN)/python -m pytest -n 0 -s -rs -m exhaustive tests/explore/test_browser.py

lint: $(VENV)/.installed-test
	$(BIN)/python -m ruff format --check .
	$(BIN)/python -m ruff check .
	$(BIN)/python -m mypy

# Warnings are errors. Pages made from the package, which git does not keep, are written beside the others in docs/.
docs: $(VENV)/.installed-demo $(VENV)/.installed-docs
	$(BIN)/python -m sphinx -W --keep-going -E -q -b html -d build/doctrees docs build/docs
	@echo "written: build/docs/index.html; with the explorer, which browsers do not load from files: $(BIN)/python -m http.server -d build/docs"

stab: $(VENV)/.installed-demo
	$(BIN)/python -m agents.seeds --env-id BicycleStab-v0 --seeds 10 --out $(OUT)/BicycleStab-v0-ppo.json

lane-change: $(VENV)/.installed-demo
	$(BIN)/python -m agents.seeds --env-id BicycleLaneChange-v0 --median-of-lqr 0.8 --worst-of-lqr 0.5 \
		--out $(OUT)/BicycleLaneChange-v0-ppo.json

controllers: $(VENV)/.installed-test
	$(BIN)/python -m agents.evaluate --env-id BicycleStab-v0 --policy $(CONTROLLERS) --episodes 200 \
		--json $(OUT)/controllers_stab.json
	$(BIN)/python -m agents.evaluate --env-id BicycleLaneChange-v0 --policy $(CONTROLLERS) --episodes 200 \
		--json $(OUT)/controllers_lane_change.json

headroom: $(VENV)/.installed-demo
	$(BIN)/python -m agents.headroom --json $(OUT)/headroom.json

mpc: $(VENV)/.installed-test
	$(BIN)/python -m agents.mpc_headroom --json $(OUT)/mpc.json

entry-speed: $(VENV)/.installed-test
	$(BIN)/python -m agents.entry_speed --json $(OUT)/entry_speed.json

# Of each seed one policy. On the first course of all speeds; the time limit lets cars below 16 m/s see but its beginning.
# On the second, where nothing is found so, of one speed, beginning as the image of the LQR, which passes there two times in three.
entry-speed-learned: $(VENV)/.installed-demo
	for seed in 0 1 2 3 4; do run=runs/entry/iso3888-1-front/$$seed; [ -f $$run/policy.json ] || \
		$(BIN)/python -m agents.ppo --env-id BicycleDoubleLaneChange-v0 --seed $$seed --out $$run --total-timesteps 5000000 \
		--env-keywords '{"course": "iso3888-1", "steer": "front", "max_episode_steps": 460}' --speeds 9 34 \
		--hold 3 --history 2 --decisions 64 --success-bonus 100 || exit 1; done
	for seed in 0 1 2 3 4; do run=runs/entry/iso3888-2-front/$$seed; [ -f $$run/policy.json ] || \
		$(BIN)/python -m agents.ppo --env-id BicycleDoubleLaneChange-v0 --seed $$seed --out $$run --total-timesteps 1000000 \
		--env-keywords '{"course": "iso3888-2", "steer": "front", "speed": 17.0, "max_episode_steps": 400}' --speeds \
		--imitate lqr --critic-alone 10 --learning-rate 5e-4 --deviation 0.06 --hold 1 --noise-hold 3 --history 4 \
		--decisions 128 || exit 1; done
	$(BIN)/python -m agents.entry_speed --course iso3888-1 iso3888-2 --steer front --policy "learned=runs/entry/{course}-{steer}" \
		--keep --json $(OUT)/entry_speed.json

alignment: $(VENV)/.installed-demo
	$(BIN)/python -m agents.alignment --json $(OUT)/alignment.json

benchmark: $(VENV)/.installed-bench
	$(BIN)/python benchmarks/single_env.py --json $(OUT)/single_env.json

benchmark-vector: $(VENV)/.installed-bench
	$(BIN)/python benchmarks/vector_env.py --most 1000000 --json $(OUT)/vector_env.json; code=$$?; \
	$(BIN)/python benchmarks/picture.py --json $(OUT)/vector_env.json --out $(OUT)/performance.png && \
	$(BIN)/python benchmarks/one_car.py --json $(OUT)/one_car.json && exit $$code

learning: $(VENV)/.installed-demo
	$(BIN)/python -m agents.benchmark --out $(OUT)/benchmark.json
	for plan in ablations remedies exploration; do \
		$(BIN)/python -m agents.benchmark --plan $$plan --out $(OUT)/$$plan.json || exit 1; done

# Of the policies that ship, as BicycleStab-v0-medium.
robustness: $(VENV)/.installed-demo
	for name in $(notdir $(wildcard bicycle_env/policies/Bicycle*)); do \
		$(BIN)/python -m agents.robustness --env-id $${name%-*} --level $${name##*-} --policy pretrained classical \
			--json $(OUT)/robustness-$$name.json || exit 1; \
	done

scaling: $(VENV)/.installed-demo
	$(BIN)/python benchmarks/scaling.py --json $(OUT)/scaling.json

tensors: $(VENV)/.installed-demo
	$(BIN)/python benchmarks/torch_env.py --json $(OUT)/torch_env.json

# A row of the benchmarks that falls short here stands in its table, marked: the rest is made all the same.
results:
	$(MAKE) OUT=results demo stab lane-change controllers headroom mpc entry-speed entry-speed-learned alignment learning robustness scaling tensors
	-$(MAKE) OUT=results benchmark
	-$(MAKE) OUT=results benchmark-vector
	mv results/performance.png docs/performance.png
	$(BIN)/python -m agents.publishing
	$(BIN)/python tools/readme_tables.py

compat: $(VENV)/.installed-test
	$(BIN)/python tools/compat.py --json $(OUT)/compat.json

gymnasium-versions:
	@for version in $(GYMNASIUM_VERSIONS); do \
		echo "== gymnasium $$version"; \
		$(PYTHON) -m venv .venv-gymnasium-$$version && \
		grep -v '^gymnasium==' constraints.txt > .venv-gymnasium-$$version/constraints.txt && \
		.venv-gymnasium-$$version/bin/python -m pip install -q --disable-pip-version-check \
			-c .venv-gymnasium-$$version/constraints.txt -e ".[test]" "gymnasium==$$version" && \
		.venv-gymnasium-$$version/bin/python -m pytest -q -n auto tests/contracts || exit 1; \
	done

rllib:
	$(PYTHON) -m venv .venv-rllib
	grep -v '^gymnasium==' constraints.txt > .venv-rllib/constraints.txt
	.venv-rllib/bin/python -m pip install -q --disable-pip-version-check -c .venv-rllib/constraints.txt -e ".[agents,rllib]"
	.venv-rllib/bin/python -m agents.train_rllib --enough-return 100 --total-timesteps 500000 --out $(OUT)/rllib

clean:
	rm -rf $(VENV) .venv-gymnasium-* .venv-compat-* build dist *.egg-info
