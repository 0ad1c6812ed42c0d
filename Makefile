# Each target sets up what it needs. Only python3 (3.11 or later), pip, make and git are taken for granted.
# Progress goes to standard error, so that `make -s bench > bench.json` is a JSON file.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# pip of the new environment; or, where python3 cannot bring one (no ensurepip), pip of the machine.
PIP = $$(test -x $(BIN)/pip && echo $(BIN)/python -m pip || echo $(PYTHON) -m pip --python $(BIN)/python)
INSTALL = $(PIP) --disable-pip-version-check --quiet install
WORKERS ?= 2

say = echo "marsarm: $(1)" >&2

.PHONY: help setup demo test test-all bench brief campaign accuracy calibration ur10 joints jobs blind robot-cases robot-controls robot-cost \
  robot-engine requirements killed interrupt \
  commands damage fuzz mutants references oracle view viewers examples package cluster lint lock clean

help:
	@echo "make demo      set up, put the APXS on a rock on Mars, write a picture"
	@echo "make test      set up, run the short tests: every command, monitor and mode, replay, a scenario, a calibration"
	@echo "make test-all  set up, run all tests"
	@echo "make bench     print the benchmarks as JSON"
	@echo "make brief     run every campaign below in brief, a line for each; minutes where they take hours"
	@echo "make campaign  try the inverse kinematics on twenty million targets, print what was found as JSON"
	@echo "make accuracy  hold the error budget against ten thousand arms, print how well it holds as JSON"
	@echo "make calibration  calibrate twenty arms, print how well as JSON"
	@echo "make ur10      calibrate the real arm whose data MARSARM_DATA names, print how well as JSON"
	@echo "make joints    find hardstops and backlash again and again on many arms, print how well as JSON"
	@echo "make jobs      run every scenario, tool changes, contacts and faults on many arms, print how well as JSON"
	@echo "make blind     make, solve and score 200 cases of the diagnosis whose effect is withheld, print the score as JSON"
	@echo "make robot-cases  make, solve and score 120 sealed cases of the diagnosis of any robot, print the score as JSON"
	@echo "make robot-controls  diagnose shuffled, simulated and delayed logs, print what was named as JSON"
	@echo "make robot-cost  measure what diagnoses of a robot cost, print it as JSON, plot it in docs/robot-cost.png"
	@echo "make robot-engine  compare the simulation of the diagnosis with bare MuJoCo, print the speeds as JSON"
	@echo "make requirements  measure every requirement of the paper, write docs/requirements.md"
	@echo "make killed    kill recorded runs at random moments, print what their logs lost as JSON"
	@echo "make interrupt  press Ctrl-C at several moments of every long command, print how soon it ends as JSON"
	@echo "make references  make the reference runs of tests/replay anew, print what differs"
	@echo "make commands  send random commands to the closed loop, right and wrong, see that none does harm, print it as JSON"
	@echo "make damage    flip bits of logs and cut them, see what reading and recovery make of it, print it as JSON"
	@echo "make fuzz      feed the readers of files with broken ones for a minute, print what came of it as JSON"
	@echo "make mutants   change fsw/protect in a thousand places, print which changes its own tests do not notice"
	@echo "make oracle    compare the inverse kinematics with EAIK, if it can be installed"
	@echo "make view      play a placement in headless Chromium, print frames a second as JSON"
	@echo "make viewers   open a log in Rerun and other tools, if they can be installed"
	@echo "make examples  run the scripts of examples/, write their pictures to docs/examples"
	@echo "make package   build the source distribution and the wheel in dist/"
	@echo "make cluster   compare two Ray nodes on this machine with local processes, if Ray can be installed"
	@echo "make lint      style, types, the direction of imports, docstrings"
	@echo "make lock      choose package versions anew (needs uv)"
	@echo "make clean     remove what the other targets made"

setup: $(VENV)/ready

demo: $(VENV)/ready
	@$(call say,placing the APXS on a rock)
	@$(BIN)/marsarm place

# A file stays in one process: what its tests share is made once.
test: $(VENV)/ready
	@$(call say,running the short tests in $(WORKERS) processes)
	@$(BIN)/python -m pytest -q -n $(WORKERS) --dist loadfile -m "not slow" $(ARGS)

test-all: $(VENV)/ready
	@$(call say,running all tests in $(WORKERS) processes)
	@$(BIN)/python -m pytest -q --durations 15 -n $(WORKERS) --dist loadfile $(ARGS)

bench: $(VENV)/ready
	@$(call say,measuring; leave the machine alone for two minutes)
	@$(BIN)/python -m validation.benchmarks

# Each in a minute of one core at most; whether it is in bounds is its exit status.
brief: $(VENV)/ready
	@$(call say,every campaign in brief in $(WORKERS) processes)
	@$(BIN)/python -m validation.brief --workers $(WORKERS) $(ARGS)

campaign: $(VENV)/ready
	@$(call say,twenty million targets in $(WORKERS) processes; this takes the better part of an hour)
	@$(BIN)/python -m validation.kinematics --targets 10000000 --vectors 10000000 --workers $(WORKERS) $(ARGS)

accuracy: $(VENV)/ready
	@$(call say,arms against the error budget in $(WORKERS) processes; this takes the better part of an hour)
	@$(BIN)/python -m validation.monte_carlo --workers $(WORKERS) $(ARGS)

calibration: $(VENV)/ready
	@$(call say,calibrating twenty arms in $(WORKERS) processes; with ARGS=--closed-loop this takes half an hour)
	@$(BIN)/python -m validation.calibration --workers $(WORKERS) $(ARGS)

ur10: $(VENV)/ready
	@$(call say,calibrating the UR10; this takes a minute)
	@$(BIN)/python -m validation.ur10 $(ARGS)

joints: $(VENV)/ready
	@$(call say,hardstops and backlash in $(WORKERS) processes; this takes the better part of an hour)
	@$(BIN)/python -m validation.joints --workers $(WORKERS) $(ARGS)

jobs: $(VENV)/ready
	@$(call say,scenarios, tool changes, contacts and faults in $(WORKERS) processes; this takes the better part of two hours)
	@$(BIN)/python -m validation.jobs --workers $(WORKERS) $(ARGS)

# What was stopped goes on. SEED names other cases, OUT another folder.
SEED ?= 1
OUT ?= blind-$(SEED)
blind: $(VENV)/ready
	@$(call say,200 blind cases in $(WORKERS) processes; this takes three hours)
	@$(BIN)/python -m validation.blind make --seed $(SEED) --out $(OUT) --jobs $(WORKERS) >&2
	@$(BIN)/python -m validation.blind solve $(OUT) --jobs $(WORKERS) >&2
	@$(BIN)/python -m validation.blind score $(OUT) --json $(ARGS)

# What was stopped goes on, unless the diagnosis was changed. SEED names other cases, OUT another folder or file.
robot-cases: OUT = robot-cases-$(SEED)
robot-cases: $(VENV)/ready
	@$(call say,120 sealed cases in $(WORKERS) processes; this takes an hour)
	@$(BIN)/python -m validation.robot_cases make --seed $(SEED) --out $(OUT) --jobs $(WORKERS) >&2
	@$(BIN)/python -m validation.robot_cases solve $(OUT) --jobs $(WORKERS) >&2
	@$(BIN)/python -m validation.robot_cases score $(OUT) --json $(ARGS)

# The XL330 takes part where MARSARM_DATA names its logs.
robot-controls: OUT = robot-controls-$(SEED).jsonl
robot-controls: $(VENV)/ready
	@$(call say,controls of the diagnosis; this takes the better part of an hour)
	@$(BIN)/python -m validation.robot_controls --seed $(SEED) --results $(OUT) $(ARGS)

robot-cost: OUT = robot-cost-$(SEED).jsonl
robot-cost: $(VENV)/ready
	@$(call say,eighteen diagnoses; leave the machine alone for half an hour)
	@$(BIN)/python -m validation.robot_cost --seed $(SEED) --results $(OUT) --out docs/robot-cost.png $(ARGS)

robot-engine: $(VENV)/ready
	@$(call say,measuring; leave the machine alone for a minute)
	@$(BIN)/python -m validation.robot_engine $(ARGS)

# What is measured is stored campaign by campaign; commit it with docs/requirements.md.
requirements: $(VENV)/ready
	@$(call say,measuring the requirements; this takes half an hour)
	@$(BIN)/python -m validation.requirements --measure $(ARGS)

killed: $(VENV)/ready
	@$(call say,killing recorded runs at random moments; this takes ten minutes)
	@$(BIN)/python -m validation.killed $(ARGS)

interrupt: $(VENV)/ready
	@$(call say,interrupting every long command at several moments; this takes ten minutes)
	@$(BIN)/python -m validation.interrupt $(ARGS)

references: $(VENV)/ready
	@$(call say,making the reference runs anew)
	@$(BIN)/python -m tests.replay.remake $(ARGS)

commands: $(VENV)/ready
	@$(call say,random commands in the closed loop)
	@$(BIN)/python -m validation.commands --workers $(WORKERS) $(ARGS)

damage: $(VENV)/ready
	@$(call say,flipping two thousand bits of logs; this takes five minutes)
	@$(BIN)/python -m validation.damage $(ARGS)

# Optional, and not in the lock: atheris lets coverage guide the changes; without it they are made blindly.
fuzz: $(VENV)/ready
	@$(INSTALL) --only-binary :all: "atheris>=3" || $(call say,atheris was not installed; pip says why above)
	@$(call say,a minute of broken files)
	@$(BIN)/python -m validation.fuzz $(ARGS)

# Optional, and not in the lock. A mutant that times out is killed too; fails below 95 %.
mutants: $(VENV)/ready
	@$(INSTALL) "mutmut>=3.8" || { $(call say,mutmut was not installed; pip says why above); exit 1; }
	@$(call say,a thousand mutants in $(WORKERS) processes; this takes five minutes)
	@rm -rf mutants
	@env -u PYTHONPATH $(BIN)/mutmut run --max-children $(WORKERS) >&2
	@$(BIN)/mutmut results --all true | awk -F '[.:] *' \
	  'NF > 3 { all[$$3]++; total++; if ($$NF ~ /killed|timeout/) { dead[$$3]++; sum++ } else print } \
	  END { for (file in all) print file ".py", dead[file] + 0 "/" all[file]; print "all", sum "/" total; exit sum < 0.95 * total }'

# Optional, and not in the lock. Without its dependencies, which are for URDF files and take 240 MB: what is used
# of EAIK needs numpy alone. Where no wheel fits or no index answers, the tests are skipped and say so.
oracle: $(VENV)/ready
	@$(call say,installing EAIK from the package index; without it the comparison is skipped)
	@$(INSTALL) --no-deps --only-binary :all: "eaik>=1.2" || $(call say,EAIK was not installed; pip says why above)
	@if $(BIN)/python -c 'import eaik.pybindings.EAIK' 2>/dev/null; then \
	  $(BIN)/python -m pytest -q tests/fsw/kinematics/test_eaik.py >&2 && \
	  $(BIN)/python -m validation.oracle --targets 100000 $(ARGS); \
	else $(call say,there is no EAIK for this Python: nothing was compared); fi

# Optional, and not in the lock. Where no wheel fits or no index answers, the tests are skipped and say so.
viewers: $(VENV)/ready
	@$(call say,installing Rerun and other tools from the package index; without them their tests are skipped)
	@$(INSTALL) --only-binary :all: "pymcap-cli>=0.34" "rerun-sdk>=0.41" "mcap-ros2-support>=0.6" || \
	  $(call say,they were not installed; pip says why above)
	@$(BIN)/python -m pytest -q tests/marsarm/telemetry/test_viewers.py $(ARGS)

# What a script writes besides its picture stays in a folder that is deleted.
examples: $(VENV)/ready
	@$(call say,running the examples; this takes some minutes)
	@scratch=$$(mktemp -d) && trap 'rm -rf "$$scratch"' EXIT && cd "$$scratch" && \
	for script in "$(CURDIR)"/examples/*.py; do "$(CURDIR)/$(BIN)/python" "$$script" >&2 || exit 1; done && \
	mkdir -p "$(CURDIR)/docs/examples" && cp ./*.png "$(CURDIR)/docs/examples/"

package: $(VENV)/ready
	@$(call say,building the source distribution, and the wheel from it, in dist/)
	@$(BIN)/python .ci/package.py dist >/dev/null

# Chromium is optional; without it the benchmark says so.
view: $(VENV)/ready
	@$(call say,playing a placement in headless Chromium; leave the machine alone for three minutes)
	@$(BIN)/python -m validation.view $(ARGS)

# Optional, and not in the lock. Without Ray the tests are skipped and say so, and the benchmark says what is missing.
cluster: $(VENV)/ready
	@$(call say,installing Ray from the package index; without it nothing is tried)
	@$(INSTALL) --only-binary :all: "ray~=2.60.0" || $(call say,Ray was not installed; pip says why above)
	@$(BIN)/python -m pytest -q tests/marsarm/common/test_cluster.py >&2
	@$(call say,200 arms on two nodes; this takes five minutes)
	@$(BIN)/python -m validation.cluster $(ARGS)

# All six speak before any of them stops the target.
lint: $(VENV)/ready
	@$(call say,ruff; mypy; import-linter; docstrings and sizes; files made from arm.toml; requirements)
	@failed=0; \
	$(BIN)/ruff check --quiet --no-cache . || failed=1; \
	$(BIN)/mypy || failed=1; \
	$(BIN)/lint-imports --no-logo --no-cache || failed=1; \
	$(BIN)/python .ci/style.py || failed=1; \
	$(BIN)/marsarm arm --check >/dev/null || failed=1; \
	$(BIN)/python -m validation.requirements --check || failed=1; \
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
