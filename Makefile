# setup   make .venv                                  bench     measure speeds, as JSON
# demo    place the APXS on a rock, draw a picture    campaign  run the campaign NAME, or list all
# test    run the short tests                         package   build wheel and source distribution in dist/
# test-all  run all tests                             lock      choose package versions anew (needs uv)
# lint    style, types, imports, docstrings, links    clean     remove what the others made
# site    documents and Python reference as a site, in build/site
#
# Each target sets up what it needs. Only python3 (3.11 or later), pip, make and git are taken for granted.
# Progress goes to standard error, so that `make -s bench > bench.json` is a JSON file.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# pip of the new environment; or, where python3 cannot bring one (no ensurepip), pip of the machine.
PIP = $$(test -x $(BIN)/pip && echo $(BIN)/python -m pip || echo $(PYTHON) -m pip --python $(BIN)/python)
INSTALL = $(PIP) --disable-pip-version-check --quiet install
WORKERS ?= 2

# What Python compiled stays: each of the many processes of a test would compile it anew.
unexport PYTHONDONTWRITEBYTECODE

say = echo "marsarm: $(1)" >&2

.PHONY: setup demo test test-all bench campaign lint lock package site clean

setup: $(VENV)/ready

demo: $(VENV)/ready
	@$(call say,placing the APXS on a rock)
	@$(BIN)/marsarm place

# A file stays in one process: what its tests share is made once.
test: $(VENV)/ready
	@$(call say,running the short tests in $(WORKERS) processes)
	@$(BIN)/python -m pytest -q -n $(WORKERS) -m "not slow" $(ARGS)

test-all: $(VENV)/ready
	@$(call say,running all tests in $(WORKERS) processes)
	@$(BIN)/python -m pytest -q --durations 15 -n $(WORKERS) $(ARGS)

bench: $(VENV)/ready
	@$(call say,measuring; leave the machine alone for two minutes)
	@$(BIN)/python -m validation benchmarks --json $(ARGS)

# NAME=hardstops ARGS="--brief --json"; without NAME they are listed. NAME=brief runs every campaign in brief.
campaign: $(VENV)/ready
	@$(BIN)/python -m validation $(NAME) --workers $(WORKERS) $(ARGS)

package: $(VENV)/ready
	@$(call say,building the source distribution, and the wheel from it, in dist/)
	@$(BIN)/python .ci/package.py dist >/dev/null

site: $(VENV)/ready
	@$(BIN)/python -c "import furo, myst_nb" 2>/dev/null || { $(call say,installing Sphinx and its theme); \
	  $(PIP) --disable-pip-version-check --quiet install --no-build-isolation -e simgap -e '.[site]'; }
	@$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going -c docs . build/site
	@$(call say,the first page is build/site/index.html)

# All seven speak before any of them stops the target.
lint: $(VENV)/ready
	@$(call say,ruff; mypy; import-linter; docstrings and sizes; links; files made from arm.toml; requirements)
	@failed=0; \
	$(BIN)/ruff check --quiet --no-cache . || failed=1; \
	$(BIN)/mypy || failed=1; \
	$(BIN)/lint-imports --no-logo --no-cache || failed=1; \
	$(BIN)/python .ci/style.py || failed=1; \
	$(BIN)/python .ci/links.py || failed=1; \
	$(BIN)/marsarm arm --check >/dev/null || failed=1; \
	$(BIN)/python -m validation requirements --brief || failed=1; \
	exit $$failed

$(VENV)/ready: $(VENV)/locked pyproject.toml simgap/pyproject.toml
	@$(INSTALL) --no-deps --no-build-isolation -e simgap -e .
	@touch $@

$(VENV)/locked: requirements.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  $(call say,$(PYTHON) is missing or older than 3.11. Install Python 3.11 or later or name one: make PYTHON=python3.12); exit 1; }
	@$(call say,setting up $(VENV) with $$($(PYTHON) -V))
	@if $(PYTHON) -c 'import venv; from ensurepip import version' 2>/dev/null; then $(PYTHON) -m venv --clear $(VENV); \
	elif $(PYTHON) -c 'import venv, pip' 2>/dev/null; then $(PYTHON) -m venv --clear --without-pip $(VENV); \
	else $(call say,$(PYTHON) cannot make a virtual environment. On Debian or Ubuntu: apt-get install python3-venv); exit 1; fi
	@$(call say,installing the packages of requirements.lock; about 200 MB the first time)
	@$(INSTALL) --require-hashes -r requirements.lock || { \
	  $(call say,the packages were not installed; pip says why above. It needs a package index or a proxy that it can reach.); exit 1; }
	@touch $@

lock:
	@command -v uv >/dev/null || { $(call say,uv is missing. Install it: pip install uv); exit 1; }
	@uv pip compile --quiet --universal --fork-strategy fewest --python-version 3.11 --generate-hashes \
	  --no-emit-package simgap --no-emit-index-url --no-emit-find-links --custom-compile-command "make lock" \
	  --extra test --group build $(ARGS) -o requirements.lock pyproject.toml simgap/pyproject.toml

clean:
	@rm -rf $(VENV) *.egg-info build dist mutants .hypothesis .mypy_cache .ruff_cache .pytest_cache place.png reach.png
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +
