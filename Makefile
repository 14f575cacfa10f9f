# Two commands are enough on a fresh machine with Python 3.11, 3.12 or 3.13: `make pick` and `make test`.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV ?= .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --disable-pip-version-check -c constraints.txt
NEWEST := .venv-newest
JOBS ?= 2
# A file's tests run in one process, which builds the file's cells once.
DIST := --dist loadfile --no-loadscope-reorder
# The tests and the processes that they start compile every module anew where an environment forbids to keep bytecode.
export PYTHONDONTWRITEBYTECODE =
BENCH ?= cell
ARGS ?=

.PHONY: setup pick test test-fast test-newest lint type docs bench picture build clean help
.DEFAULT_GOAL := help

help:  ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

# A stamp is newer than what it was made from: a second call installs nothing.
$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.run-stamp: pyproject.toml constraints.txt | $(BIN)/python
	@echo "1 of 2  installing binpick into $(VENV): torch and MuJoCo are large, a few minutes the first time"
	$(PIP) torch==2.13.0
	$(PIP) -e .
	@touch $@

$(VENV)/.dev-stamp: pyproject.toml constraints.txt | $(BIN)/python
	@echo "installing binpick with everything for development into $(VENV) ..."
	$(PIP) torch==2.13.0
	$(PIP) -e '.[learn,report,viz,cameras,cluster,docs,dev]' hatchling
	@touch $@ $(VENV)/.run-stamp

setup: $(VENV)/.dev-stamp  ## make .venv with everything for development

pick: $(VENV)/.run-stamp  ## install, and run the main job on two bins of tees
	@echo "2 of 2  picking two bins; part models and kernels are made once per machine, about a minute"
	$(BIN)/binpick pick --part tee --bins 2 $(ARGS)

test: $(VENV)/.dev-stamp  ## install, and run every test
	$(BIN)/python -m pytest -n $(JOBS) $(DIST) $(ARGS)

test-fast: $(VENV)/.dev-stamp  ## the tests without long simulations, trainings and processes
	$(BIN)/python -m pytest -n $(JOBS) $(DIST) -m 'not slow' $(ARGS)

test-newest:  ## every test on the newest versions of all dependencies, in an environment of its own
	rm -rf $(NEWEST)
	$(PYTHON) -m venv $(NEWEST)
	$(NEWEST)/bin/python -m pip install --disable-pip-version-check --upgrade -e '.[learn,report,viz,cameras,cluster,docs,dev]' hatchling
	$(NEWEST)/bin/python -m pip freeze --exclude-editable > $(NEWEST)/versions.txt
	$(NEWEST)/bin/python -m pytest -n $(JOBS) $(DIST) $(ARGS)

lint: $(VENV)/.dev-stamp  ## ruff, and the direction of the imports
	$(BIN)/ruff check .
	$(BIN)/lint-imports

type: $(VENV)/.dev-stamp  ## mypy --strict
	$(BIN)/mypy
	$(BIN)/mypy scripts/*.py

docs: $(VENV)/.dev-stamp  ## the site, in docs/_build, without a network
	$(BIN)/python -m sphinx -q -W -b html docs docs/_build
	@echo "open docs/_build/index.html"

bench: $(VENV)/.run-stamp  ## a benchmark: make bench BENCH=cell ARGS='--save FILE'
	$(BIN)/binpick bench $(BENCH) $(ARGS)

picture: $(VENV)/.run-stamp  ## the pictures of README.md and of docs/explanation/method.md
	$(BIN)/binpick picture --part tee --seed 0 --out docs/images/cell.png
	$(BIN)/binpick picture --show segmentation --part tee --seed 7 --out docs/images/segmentation.png
	$(BIN)/binpick picture --show poses --part tee --seed 7 --out docs/images/poses.png

build: $(VENV)/.dev-stamp  ## the wheel in dist/, tested alone from another directory
	rm -rf dist
	$(BIN)/python -m build --wheel --no-isolation --outdir dist
	BINPICK_WHEEL=$$(ls dist/*.whl) $(BIN)/python -m pytest tests/test_wheel.py -m slow

clean:  ## remove what was made, results in runs/ excepted
	rm -rf $(VENV) $(NEWEST) dist build docs/_build .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
