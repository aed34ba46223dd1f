# All targets work in .venv, which is created from requirements.lock if it is missing or older.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
INPUTS ?= 1000
SHARD ?= 1/1
TEST ?= kill
SIZE ?=
SEED ?= 1
FACTOR ?= 1.2

# Python stores what it compiles, whatever the environment says: the tests start some hundred processes.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: help env wheel demo test test-slow coverage fuzz endurance sensitivity gate lint format docs reference gallery lock clean

help:
	@echo "make demo        simulate a robot in a museum, map it, write demo/, open the viewer on a desktop"
	@echo "make test        run the tests"
	@echo "make test-slow   run all tests, also the long ones"
	@echo "make coverage    run the tests and report which lines they cover"
	@echo "make fuzz        read damaged files of all kinds; INPUTS=100000 SHARD=1/4 sets their number and the part of them"
	@echo "make endurance   kill live runs, cut their power, fill their disk, damage their devices; TEST=kill, power, disk, faults, pairs, ros or grid"
	@echo "make sensitivity map the recordings in \$$WCLM_DATASETS with all constants changed at random; SEED=1 FACTOR=1.2"
	@echo "make gate        fail if accuracy or speed is worse than the stored limits"
	@echo "make lint        ruff and mypy"
	@echo "make format      format the code with ruff"
	@echo "make docs        build the documentation into site/; open site/index.html"
	@echo "make reference   write the documentation of commands and settings from the code"
	@echo "make gallery     draw the pictures of the documentation (simulated drives, recordings in \$$WCLM_DATASETS)"
	@echo "make env         create .venv only; then run .venv/bin/wclm --help"
	@echo "make wheel       build a wheel for this platform with compiled functions, into dist/"
	@echo "make lock        update requirements.lock (needs uv)"

env: $(READY)

# Modules are not compiled when they are installed: a quarter is imported, which Python then compiles and stores.
$(READY): requirements.lock pyproject.toml
	@test ! -L $(VENV) || { echo "$(VENV) is a link, and what it leads to would be deleted; remove the link first"; exit 2; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python >= 3.11 is needed; choose one with: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 2; }
	$(PYTHON) -m venv --clear $(VENV)
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check --require-hashes --requirement requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@echo "compiling, once; takes about a minute"; $(BIN)/python -c "import slam; slam.warm_up()"
	@touch $@

demo: $(READY)
	$(BIN)/wclm demo --out demo --overwrite

# Three processes keep two processors busy while tests wait for emulated devices; more of them take more processor time.
test: $(READY)
	$(BIN)/python -m pytest -n 3 --dist worksteal -m "not slow"

test-slow: $(READY)
	$(BIN)/python -m pytest

coverage: $(READY)
	$(BIN)/python -m pytest -n 3 --dist worksteal -m "not slow" --cov=slam --cov=features --cov=drivers --cov-report=term:skip-covered

fuzz: $(READY)
	$(BIN)/python -m tests.fuzzing --inputs $(INPUTS) --shard $(SHARD)

endurance: $(READY)
	$(BIN)/python -m tests.endurance $(TEST) $(if $(SIZE),--size $(SIZE))

sensitivity: $(READY)
	$(BIN)/python -m tests.sensitivity --seed $(SEED) --factor $(FACTOR)

gate: $(READY)
	$(BIN)/wclm bench gate

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: $(READY)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

reference: $(READY)
	$(BIN)/python docs/tools/reference.py

gallery: $(READY)
	$(BIN)/wclm demo --gallery docs/pictures

# Not in an isolated environment: functions are compiled with the project's own libraries.
wheel: $(READY)
	WCLM_COMPILED=1 $(BIN)/python -m hatchling build -t wheel

lock:
	uv pip compile pyproject.toml --all-extras --group dev --universal --python-version 3.11 --generate-hashes --no-annotate --no-header --no-strip-extras --output-file requirements.lock

clean:
	rm -rf $(VENV) demo dist build site .pytest_cache .mypy_cache .ruff_cache .hypothesis .coverage
