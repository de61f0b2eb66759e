# make train      installs into .venv and starts a run on this machine
# make test       installs into .venv and runs the checks and all tests but the slow ones
# make test-all   the slow tests too: many faults in a row, long pauses, learning
# make check      lint, types and the unit tests of one room: make check ROOM=planners
# make docs       the documentation as a site in site/
#
# PYTHON names the Python that .venv is made of; RUN_FILE and ARGS go to `athrl train`; JOBS is how many
# processes run tests side by side, PYTEST_ARGS what else pytest is told.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/installed
DOCS := .venv-docs
DOCS_INSTALLED := $(DOCS)/installed
ROOMS := spaces protocol driving accelerate planners services/actor services/learner services/evaluator athrl
RUN_FILE ?= presets/default.toml
PYTEST_ARGS ?=
ROOM ?= spaces
JOBS ?= $(shell expr 2 \* $$(nproc))
PYTEST := $(BIN)/pytest --numprocesses=$(JOBS) --dist=worksteal

.PHONY: help install train test test-all check lint kernels format docs images clean

# Tests start hundreds of processes: where no bytecode is kept, each of them compiles every source again.
test test-all check: export PYTHONDONTWRITEBYTECODE =

help:
	@sed -n 's/^# \{0,1\}//p' Makefile | head -n 8

install: $(INSTALLED)

$(INSTALLED): constraints.txt requirements-dev.txt $(ROOMS:%=%/pyproject.toml)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "athrl needs Python 3.11 or newer: name one with make PYTHON=/path/to/python3" >&2; exit 1; }
	@test -x $(BIN)/pip || $(PYTHON) -m venv $(VENV) || \
		{ echo "$(PYTHON) cannot make a virtual environment: install its venv module (python3-venv)" >&2; exit 1; }
	@echo "installing into $(VENV); the first time this takes a few minutes"
	$(BIN)/pip install --quiet --constraint constraints.txt hatchling editables
	$(BIN)/pip install --quiet --constraint constraints.txt --no-build-isolation \
		--requirement requirements-dev.txt $(ROOMS:%=--editable ./%)
	@touch $@

train: $(INSTALLED)
	@$(BIN)/athrl train --run-file "$(RUN_FILE)" $(ARGS)

# What is checked and what is compiled take a core each; without this the tests' first minute is spent waiting
# for the one process that compiles.
test: $(INSTALLED)
	@$(MAKE) --no-print-directory --jobs=2 lint kernels
	$(PYTEST) -m "not slow" $(PYTEST_ARGS)

# Runs that must recover within seconds have the machine for themselves.
test-all: test
	$(BIN)/pytest -m slow tests/liveness tests/chaos $(PYTEST_ARGS)
	$(BIN)/pytest --numprocesses=2 --dist=worksteal -m slow --ignore=tests/liveness --ignore=tests/chaos $(PYTEST_ARGS)

check: lint
	$(PYTEST) -m "not slow" $(ROOM)/tests $(PYTEST_ARGS)

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

kernels: $(INSTALLED)
	@$(BIN)/python -m tests.compile_kernels

format: $(INSTALLED)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# An environment of its own: mkdocstrings reads the sources, nothing of athrl has to be installed.
$(DOCS_INSTALLED): constraints.txt requirements-docs.txt
	$(PYTHON) -m venv $(DOCS)
	$(DOCS)/bin/pip install --quiet --constraint constraints.txt --requirement requirements-docs.txt
	@touch $@

docs: $(DOCS_INSTALLED)
	NO_MKDOCS_2_WARNING=1 $(DOCS)/bin/mkdocs build --strict

images:
	deploy/build-images.sh

clean:
	rm -rf $(VENV) $(DOCS) site .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -not -path './.git/*' -prune -exec rm -rf {} +
