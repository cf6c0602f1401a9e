# Commands for people and CI. Everything runs in .venv; nothing outside the repository is changed.
#   make PYTHON=python3.12 test      another interpreter (after `make clean` if .venv exists)
#   make test PYTEST="-k fatigue"    more arguments for pytest
#   make rivals RIVALS=--quick       three families and two rounds instead of all
#   make rivals RIVALS=--whole-bodies  arm, legs, torso, relocate and full body instead
#   make learning LEARNING=--quick   the elbow alone
#   make test-view MINUTES=10        watch the memory for ten minutes instead of one
#   make opensim OPENSIM=--quick     one model and two rounds instead of all
#   make gpu-run DEVICE=cpu SIZES=16 GPU='--budget 300'   a dry run of the kit on the CPU

SHELL := bash
.DEFAULT_GOAL := help

PYTHON ?= python3
PYTEST ?=
RIVALS ?=
LEARNING ?=
OPENSIM ?=
DEVICE ?= cuda:0
SIZES ?= 1024 4096 8192 32768
GPU ?=
MODELS ?=
CHECKED = $(or $(MODELS),$(addprefix tests/data/osim/,$(addsuffix .osim,arm26 leg6dof9musc gait10dof18musc)))
MOTIONS = $(filter %gait10dof18musc.osim %Rajagopal2016.osim,$(CHECKED) $(wildcard ../shared/osim/Rajagopal2016.osim))
TRIAL ?= $(wildcard ../shared/osim/motion/gait2354)
OLDER ?=
MINUTES ?= 1
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
TEST_STAMP := $(VENV)/.installed-test
PIP := $(BIN)/python -m pip --disable-pip-version-check --no-input
# No byte code beforehand: half of the time of installing; Python makes it of what is imported.
# pip's log is cut to one line per download; its errors go to stderr and stay complete.
install = set -o pipefail; $(PIP) install --no-compile --progress-bar off -e ".[$(1)]" | awk '/Downloading|Installing collected/ { print substr($$0, 1, 100); fflush() }'

.PHONY: help setup demo test fast test-slow scale lint format bench gpu gpu-kit gpu-run rivals opensim opensim-check accuracy parity soak audit docs pictures dist learning test-view clean

help: ## Show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-10s  %s\n", $$1, $$2 }' Makefile

setup: $(STAMP) ## Create .venv and install MyoWarp with the development tools

$(STAMP): pyproject.toml
	@command -v $(PYTHON) >/dev/null || { \
	  echo "MyoWarp needs Python 3.11 or newer; '$(PYTHON)' was not found. Choose one: make PYTHON=/path/to/python3.11 setup" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "MyoWarp needs Python 3.11 or newer; '$(PYTHON)' is $$($(PYTHON) --version). Choose another: make PYTHON=python3.12 setup" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
	  echo "'$(PYTHON)' has no venv module. On Debian or Ubuntu: apt-get install python3-venv" >&2; exit 1; }
	@echo "Creating $(VENV) with $$($(PYTHON) --version)"
	@$(PYTHON) -m venv $(VENV)
	@$(PIP) install --quiet --upgrade pip
	@echo "Installing MyoWarp and its dependencies (a few hundred megabytes the first time)"
	@$(call install,dev)
	@touch $@
	@echo "Ready: $(BIN)/myowarp --help"

$(TEST_STAMP): $(STAMP)
	@echo "Installing what the tests need besides: torch and the trainers (with CUDA libraries several gigabytes)"
	@$(call install,test)
	@touch $@

demo: setup ## Film 256 trained hands that reach for targets: success rate, out/demo.mp4
	$(BIN)/myowarp rollout MyoWarp/myoHandReachRandom-v1 --policy baselines/myoHandReachRandom-v0 --num-worlds 256 --video out/demo.mp4 --overwrite

test: lint fast ## Check format, lint and types, then run the fast tests (what CI runs)

# There are as many workers as cores: each has one, for its worlds and for its matrices.
fast: $(TEST_STAMP) ## Run the fast tests alone
	MYOWARP_CORES=1 OMP_NUM_THREADS=1 $(BIN)/python -m pytest -m "not slow and not view and not scale" -n auto --dist loadfile $(PYTEST)

test-slow: $(TEST_STAMP) ## Run the tests marked slow
	$(BIN)/python -m pytest -m "slow and not scale" $(PYTEST)

scale: $(TEST_STAMP) ## Kill ranks, workers, nodes and drivers, and compare with undisturbed runs (5 to 15 minutes)
	$(BIN)/python -m pytest -m scale $(PYTEST)

test-view: $(TEST_STAMP) ## Test the page of `myowarp view` in a headless Chromium, which is installed where apt-get is
	@command -v chromium >/dev/null || apt-get install --yes --no-install-recommends chromium || { \
	  echo "Install Chromium first (Debian: apt-get install chromium)" >&2; exit 1; }
	MYOWARP_VIEW_MINUTES=$(MINUTES) $(BIN)/python -m pytest -m view -rP $(PYTEST)

lint: $(TEST_STAMP) ## Check format, lint and types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy -n 2

format: setup ## Format the code and apply safe lint fixes
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: setup ## Measure speed, conditions, overhead, what a world costs, policies beside it, JSON to out/
	@mkdir -p out
	$(BIN)/python -m benchmarks --output out/bench.json
	$(BIN)/python -m benchmarks.conditions --output out/conditions.json
	$(BIN)/python -m benchmarks.overhead --output out/overhead.json
	$(BIN)/python -m benchmarks.worlds --output out/worlds.json
	$(BIN)/python -m benchmarks.memory --output out/memory.json
	$(BIN)/python -m benchmarks.policies --output out/policies.json

gpu: setup ## Measure on this machine's GPU, JSON to out/gpu.json (9 minutes)
	$(BIN)/python -m benchmarks.gpu --output out/gpu.json

gpu-kit: setup ## Pack what a GPU machine without internet needs, for Python 3.12, into parts in out/gpu_kit
	$(BIN)/python -m benchmarks.gpu_kit out/gpu_kit

gpu-run: ## Measure from out/gpu_kit alone, JSON to out (DEVICE=cpu SIZES="16 64": a dry run; PYTHON=...)
	PYTHON=$(if $(filter python3,$(PYTHON)),python3.12,$(PYTHON)) out/gpu_kit/run.sh out/gpu_kit out --device $(DEVICE) --sizes $(SIZES) $(GPU)

rivals: setup .venv-parity/.installed .venv-envpool/.installed ## Measure speed beside MyoSuite, EnvPool and MuJoCo C (8 to 20 minutes, idle cores)
	$(BIN)/python -m benchmarks.rivals --output out/rivals.json $(RIVALS)

learning: $(TEST_STAMP) .venv-parity/.installed .venv-envpool/.installed ## Measure the time to success beside MyoSuite and EnvPool (hours; LEARNING=--quick: minutes)
	$(BIN)/python -m benchmarks.learning --output out/learning.json $(LEARNING)

opensim: setup .venv-opensim/.installed ## Measure speed beside OpenSim with 1 to 64 times the muscles (5 to 12 minutes; OPENSIM="ARM.osim GAIT.osim")
	$(BIN)/python -m benchmarks.opensim_speed --output out/opensim_speed.json $(OPENSIM)

opensim-check: setup .venv-opensim/.installed ## Compare muscles, paths and recorded motions with OpenSim's (MODELS="ARM.osim GAIT.osim", TRIAL=FOLDER)
	$(BIN)/python -m benchmarks.opensim_muscles --work out/opensim_muscles $(CHECKED)
	$(BIN)/python -m benchmarks.muscle_bench
	$(BIN)/python -m benchmarks.opensim_energy $(CHECKED)
	.venv-opensim/bin/python benchmarks/opensim_paths_record.py $(CHECKED) -o out/paths
	$(BIN)/python -m benchmarks.opensim_paths $(CHECKED) --recorded out/paths -o out/opensim_paths.json
	.venv-opensim/bin/python benchmarks/opensim_motion_record.py $(MOTIONS) $(addprefix --trial ,$(TRIAL)) -o out/motion
	$(BIN)/python -m benchmarks.opensim_motion $(MOTIONS) $(addprefix --trial ,$(TRIAL)) --recorded out/motion -o out/opensim_motion.json

accuracy: setup ## Measure the error of the physics presets against 0.1 ms steps, JSON to out/accuracy.json
	@mkdir -p out
	$(BIN)/python -m benchmarks.accuracy --output out/accuracy.json

# Rivals live in environments of their own: their pins differ from ours.
.venv-parity/.installed: RIVAL := myosuite==3.0.0
.venv-envpool/.installed: RIVAL := envpool==1.2.5
.venv-opensim/.installed: RIVAL := opensim==4.6
.venv-parity/.installed .venv-envpool/.installed .venv-opensim/.installed:
	@test -x $(@D)/bin/python || $(PYTHON) -m venv $(@D)
	@echo "Installing $(RIVAL) (a gigabyte the first time)"
	@$(@D)/bin/python -m pip install --quiet --disable-pip-version-check $(RIVAL)
	@touch $@

parity: setup .venv-parity/.installed ## Install MyoSuite 3.0.0 beside us, record fresh values, compare every id
	@mkdir -p out
	$(BIN)/python -m benchmarks.parity --recorder .venv-parity/bin/python --output out/parity.json

soak: setup ## Run random actions in all 204 ids of the paper's grid, other ids and pairs of conditions (20 minutes to three hours)
	@mkdir -p out
	$(BIN)/python -m benchmarks.soak --output out/soak.json
	$(BIN)/python -m benchmarks.soak --others --output out/soak_others.json
	$(BIN)/python -m benchmarks.soak --pairs --output out/soak_pairs.json
	$(BIN)/python -m benchmarks.soak --muscles --num-worlds 256 --output out/soak_muscles.json

audit: setup ## Audit every task, table, JSON and page to out/audit (10 minutes to an hour)
	$(BIN)/myowarp audit --output out/audit --overwrite

docs: $(TEST_STAMP) ## Build the documentation site into out/docs
	$(BIN)/sphinx-build -W --keep-going -j auto docs out/docs
	@echo "Open out/docs/index.html"

CHANGED := myowarp/apps/studies/reproduce/policies/changing_myoElbowPose1D6MRandom-v0_device
TORN := myowarp/apps/studies/reproduce/policies/changing_myoHandKeyTurnFixed-v0_tear

pictures: setup ## Draw every body and task family, and what trained policies do, into docs/pictures
	$(BIN)/python docs/pictures/contact_sheet.py
	$(BIN)/python docs/pictures/film_strips.py
	$(BIN)/python docs/pictures/demo.py
	$(BIN)/myowarp record myoElbowPose1D6MRandom-v0 --policy $(CHANGED)_memory/0 --beside-policy $(CHANGED)_blind/0 \
	--conditions 'joint_device(stiffness=0.0, assistance=Ramp(0.0, 2.0, onset=0.6), delay=0.1)' --seed 1 \
	--size 360 270 --fps 25 --output docs/pictures/adaptation.gif --overwrite
	$(BIN)/myowarp record myoHandKeyTurnFixed-v0 --policy baseline --beside-policy $(TORN)_blind/0 --seed 1 \
	--conditions 'tendon_tear(transmission=Ramp(1.0, 0.0, onset=0.3))' --physics parity --steps 70 \
	--size 360 270 --fps 20 --output docs/pictures/tear.gif --overwrite
	$(BIN)/myowarp cohort examples/elbow_cohort.csv --task myoElbowPose1D6MFixed-v0 --reset fixed --steps 500 --output out/cohort --overwrite
	$(BIN)/myowarp plot assistance out/cohort --output docs/pictures/assistance.png --overwrite

# Wheel and sdist, and the wheel at work: installed into an empty environment, away from this folder.
dist: setup ## Build wheel and sdist into dist, check them, try the wheel in an empty environment (OLDER=x.whl: over it)
	rm -rf dist build
	$(PIP) install --quiet build twine
	$(BIN)/python -m build
	$(BIN)/twine check --strict dist/*
	$(BIN)/python tests/try_wheel.py dist/*.whl $(OLDER)

clean: ## Remove .venv, caches and outputs
	rm -rf $(VENV) .venv-parity .venv-envpool .venv-opensim out build dist .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
