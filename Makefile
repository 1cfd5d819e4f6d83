# Every target sets up .venv first when it is missing or when requirements.lock or pyproject.toml
# changed. Needs only Python >= 3.11 with pip, and make.
#
#   make check                           lint, types and the quick tests: while you work
#   make test                            lint, types and all tests: before you send a change
#   make docs                            the documentation as a site in out/docs
#   make demo ARGS="--bank MY_BANK"      extra arguments for the command behind a target
#   make test ARGS="-k sic" WORKERS=8    tests by name, on eight processes
#   make setup PYTHON=/path/to/python3   another interpreter
#   make setup PIP_ARGS="..."            extra arguments for pip (see requirements.lock)

# Tried in this order; the first that runs and is new enough makes .venv.
PYTHON ?= python3.11 python3 python3.12 python3.13
PIP_ARGS ?=
ARGS ?=
WORKERS ?= 2

VENV := .venv
PY := $(VENV)/bin/python
STAMP := $(VENV)/.installed
PACKAGES := amusic_gym baselines agents scripts examples tests

.PHONY: help setup demo docs check test lint format bench train-default clean

help:
	@sed -n '/^#/!q; s/^# \{0,1\}//p' Makefile
	@echo; echo "Targets: setup demo docs check test lint format bench train-default clean"

setup: $(STAMP)

$(STAMP): requirements.lock pyproject.toml
	@set -eu; \
	supported='import sys; sys.exit(sys.version_info < (3, 11))'; \
	if ! $(PY) -c "import pip; $$supported" 2>/dev/null; then \
	    chosen=; \
	    for candidate in $(PYTHON); do \
	        if "$$candidate" -c "$$supported" 2>/dev/null; then chosen=$$candidate; break; fi; \
	    done; \
	    if [ -z "$$chosen" ]; then \
	        echo "error: no Python >= 3.11 among: $(PYTHON);" \
	            "install one, or name it: make setup PYTHON=/path/to/python3" >&2; \
	        exit 2; \
	    fi; \
	    echo "Creating $(VENV) with $$chosen ($$("$$chosen" --version))"; \
	    if "$$chosen" -c 'import ensurepip, venv' 2>/dev/null; then \
	        "$$chosen" -m venv --clear $(VENV); \
	    else \
	        "$$chosen" -m venv --clear --without-pip $(VENV); \
	        "$$chosen" -m pip --python $(PY) install --quiet pip; \
	    fi; \
	fi; \
	echo "Installing the pinned dependencies; the first time this takes some minutes"; \
	$(PY) -m pip install --quiet --disable-pip-version-check $(PIP_ARGS) -r requirements.lock; \
	$(PY) -m pip install --quiet --disable-pip-version-check \
	    --no-deps --no-build-isolation --editable .; \
	touch $@

demo: setup
	$(PY) scripts/demo.py --out out/demo $(ARGS)

docs: setup
	$(PY) -m pip install --quiet --disable-pip-version-check $(PIP_ARGS) -r docs/requirements.txt
	$(PY) -m sphinx -W --keep-going -q docs out/docs

# Small arrays on several processes: one thread each is fastest.
check test: export OMP_NUM_THREADS ?= 1
# Hundreds of processes would each compile the sources where a shell says to keep no bytecode.
check test: export PYTHONDONTWRITEBYTECODE :=
check: lint
	$(PY) -m pytest -n $(WORKERS) --dist worksteal -m "not slow" $(ARGS)

test: lint
	$(PY) -m pytest -n $(WORKERS) --dist worksteal $(ARGS)

lint: setup
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(PY) -m mypy

format: setup
	$(PY) -m ruff check --fix .
	$(PY) -m ruff format .

bench: setup
	@mkdir -p out
	$(PY) scripts/bench.py --out out/bench.json $(ARGS)

# The selector that ships, again from its seed: agents/amusic_agents/pretrained/CARD.md.
train-default: export OMP_NUM_THREADS ?= 1
train-default: setup
	$(PY) scripts/train_default.py --out out/default $(ARGS)

# What the targets above made; trained runs elsewhere stay.
clean:
	rm -rf $(VENV) out/demo out/default out/bench.json build dist *.egg-info
	rm -rf .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find $(wildcard $(PACKAGES)) -name __pycache__ -prune -exec rm -rf {} +
