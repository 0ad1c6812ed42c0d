# setup   make .venv, also for tests                  bench     measure speeds, as JSON
# demo    place the APXS on a rock; write a picture   campaign  run the campaign NAME, or list all
#         and a page that plays it                    lint      style, types, imports, docstrings, links
# show    the same page, opened in the browser        clean     remove what the others made
# test    run the short tests                         site      documents and Python reference, in build/site
# test-all  run all tests
#
# Each target sets up what it needs. Only python3 (3.11 or later), pip, make and git are taken for granted.
# Progress goes to standard error, so that `make -s bench > bench.json` is a JSON file.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# pip of the machine, which takes no time to set up; or, where it is missing or too old, that of the new environment.
# It installs the pip of the lock, which needs half the time for all the others.
HAS_PIP = $(PYTHON) -c 'import sys, venv; from importlib.metadata import version as v; sys.exit(int(v("pip").split(".")[0]) < 23)' 2>/dev/null
FIRST_PIP = $$($(HAS_PIP) && echo $(PYTHON) -m pip --python $(BIN)/python || echo $(BIN)/python -m pip)
PIP = $(BIN)/python -m pip
QUIETLY = --disable-pip-version-check --quiet
# Python compiles what is imported; to compile all that is installed takes 15 s of a processor.
ONLY = --no-compile --no-deps
INSTALL = $(PIP) $(QUIETLY) install $(ONLY)
# Setuptools, of half 1, installs this project, and warns of each folder that is installed as it stands.
LINK = PYTHONWARNINGS=ignore $(INSTALL) --no-build-isolation -e simgap -e .
WORKERS ?= 2

# What Python compiled stays: each of the many processes of a test would compile it anew.
unexport PYTHONDONTWRITEBYTECODE

NOT_INSTALLED = the packages were not installed; pip says why above. It needs a package index or a proxy that it can reach.
say = echo "marsarm: $(1)" >&2

.PHONY: setup demo show test test-all bench campaign lint site clean

setup: $(VENV)/tests

demo: $(VENV)/ready
	@$(call say,placing the APXS on a rock)
	@$(BIN)/marsarm place --page place.html

show: $(VENV)/ready
	@$(call say,placing the APXS on a rock)
	@$(BIN)/marsarm show

# A file stays in one process: what its tests share is made once.
test: $(VENV)/tests
	@$(call say,running the short tests in $(WORKERS) processes)
	@$(BIN)/python -m pytest -q -n $(WORKERS) -m "not slow" $(ARGS)

test-all: $(VENV)/tests
	@$(call say,running all tests in $(WORKERS) processes)
	@$(BIN)/python -m pytest -q --durations 15 -n $(WORKERS) $(ARGS)

bench: $(VENV)/tests
	@$(call say,measuring; leave the machine alone for two minutes)
	@$(BIN)/python -m validation benchmarks --json $(ARGS)

# NAME=hardstops ARGS="--brief --json"; without NAME they are listed. NAME=brief runs every campaign in brief.
campaign: $(VENV)/tests
	@$(BIN)/python -m validation $(NAME) --workers $(WORKERS) $(ARGS)

site: $(VENV)/tests
	@$(BIN)/python -c "import furo, myst_nb" 2>/dev/null || { $(call say,installing Sphinx and its theme); \
	  PYTHONWARNINGS=ignore $(PIP) $(QUIETLY) install --no-build-isolation -e simgap -e '.[site]'; }
	@$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going -c docs . build/site
	@$(call say,the first page is build/site/index.html)

# All six speak before any of them stops the target.
lint: $(VENV)/tests
	@$(call say,ruff; mypy; import-linter; docstrings; links; requirements)
	@failed=0; \
	$(BIN)/ruff check --quiet --no-cache . || failed=1; \
	$(BIN)/mypy || failed=1; \
	$(BIN)/lint-imports --no-logo --no-cache || failed=1; \
	$(BIN)/python .ci/style.py || failed=1; \
	$(BIN)/python .ci/links.py || failed=1; \
	$(BIN)/python -m validation requirements --brief || failed=1; \
	exit $$failed

$(VENV)/ready: $(VENV)/locked pyproject.toml simgap/pyproject.toml
	@[ $(VENV)/locked -nt pyproject.toml ] && [ $(VENV)/locked -nt simgap/pyproject.toml ] || $(LINK)
	@touch $@

$(VENV)/locked: requirements.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  $(call say,$(PYTHON) is missing or older than 3.11. Install Python 3.11 or later or name one: make PYTHON=python3.12); exit 1; }
	@$(call say,setting up $(VENV) with $$($(PYTHON) -V))
	@if $(HAS_PIP); then $(PYTHON) -m venv --clear --without-pip $(VENV); \
	elif $(PYTHON) -c 'import venv; from ensurepip import version' 2>/dev/null; then $(PYTHON) -m venv --clear $(VENV); \
	else $(call say,$(PYTHON) cannot make a virtual environment. On Debian or Ubuntu: apt-get install python3-venv); exit 1; fi
	@$(call say,installing the packages of requirements.lock; about 150 MB the first time)
	@sed -n '/^pip==/,/^    #/p' requirements.lock | $(FIRST_PIP) $(QUIETLY) install $(ONLY) --require-hashes -r /dev/stdin \
	  || { $(call say,$(NOT_INSTALLED)); exit 1; }
	@for half in 0 1; do \
	  awk -v half=$$half '/^[^ #]/ {mine = /^setuptools==/ ? half : n++ % 2 == half} mine' requirements.lock > $(VENV)/half$$half; done
	@$(INSTALL) --require-hashes -r $(VENV)/half0 & $(INSTALL) --require-hashes -r $(VENV)/half1 \
	  && $(LINK) && wait $$! \
	  || { wait; $(call say,$(NOT_INSTALLED)); exit 1; }
	@touch $@

$(VENV)/tests: $(VENV)/ready requirements-test.lock
	@$(call say,installing the packages of the tests)
	@$(INSTALL) --require-hashes -r requirements-test.lock || { $(call say,$(NOT_INSTALLED)); exit 1; }
	@touch $@

clean:
	@rm -rf $(VENV) *.egg-info build dist mutants .hypothesis .mypy_cache .ruff_cache .pytest_cache place.png place.html reach.png
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +
