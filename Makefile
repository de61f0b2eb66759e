# make train   installs into .venv and starts a run on this machine
# make test    installs into .venv and runs every check and test
#
# PYTHON names the Python that .venv is made of; RUN_FILE and ARGS go to `athrl train`.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/installed
ROOMS := spaces protocol driving planners services/actor services/learner services/evaluator athrl
RUN_FILE ?= presets/default.toml
PYTEST_ARGS ?=

.PHONY: help install train test lint format images clean

help:
	@sed -n 's/^# \{0,1\}//p' Makefile | head -n 4

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
	@$(BIN)/athrl train --run-file $(RUN_FILE) $(ARGS)

test: lint
	$(BIN)/pytest $(PYTEST_ARGS)

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(INSTALLED)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

images:
	deploy/build-images.sh

clean:
	rm -rf $(VENV) .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -not -path './.git/*' -prune -exec rm -rf {} +
