# The two commands of a new machine are `make run` and `make test`; both set up what is missing first.
.DEFAULT_GOAL := help
SHELL := /bin/bash
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
READY := $(VENV)/.ready
PEERS := .venv-peers
# Tests start many processes, and each would compile every module anew where the environment forbids to keep it.
export PYTHONDONTWRITEBYTECODE :=

SCENARIO ?= mockup-tumbling
ARGS ?=
MINUTES ?= 60
# One more than the processors of a small machine: a fifth of the time of tests that start processes is waiting.
WORKERS ?= 3

.PHONY: help run test bounds check format lint mypy pyright layers docs site document-tests collect viewers bench recording busy reading cluster hand-eye truth-error free-flight peers fuzz kills soak check-viewers lock audit setup clean

help: ## List the targets
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F':.*## ' '{printf "  make %-13s %s\n", $$1, $$2}'

setup: $(READY) ## Virtual environment, dependencies, Open3D's system libraries, compiled numerical code

$(INSTALLED): pyproject.toml constraints.txt deploy/setup.sh
	bash deploy/setup.sh $(VENV) without-code
	@touch $@

$(READY): $(INSTALLED)
	bash deploy/setup.sh $(VENV) only-code
	@touch $@

run: $(READY) ## Play a scenario: make run SCENARIO=mockup-oblique
	$(BIN)/rpod run $(SCENARIO) $(ARGS)

test: $(READY) ## The tests
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder $(ARGS)

collect: $(INSTALLED) ## The tests' files read once, so that the processes of make test need not all do it at once
	@$(BIN)/python -m pytest --collect-only -qq | tail -n 3

bounds: $(INSTALLED) ## Methods on frames that no sensor sends, their compiled code with each index checked
	NUMBA_BOUNDSCHECK=1 NUMBA_OPT=1 NUMBA_LOOP_VECTORIZE=0 NUMBA_CACHE_DIR=build/bounds PYTHONPATH=. $(BIN)/python tests/hostile_frames.py

check: format lint mypy layers test bounds docs ## All that CI checks, but the viewers

format: $(INSTALLED) ## Formatting, checked
	$(BIN)/ruff format --check

lint: $(INSTALLED) ## Lint
	$(BIN)/ruff check

mypy: $(INSTALLED) ## Types: mypy strict
	$(BIN)/mypy

pyright: $(INSTALLED) ## Types as pyright reads them, before a release
	$(BIN)/pyright

layers: $(INSTALLED) ## Import layers
	$(BIN)/lint-imports

docs: $(READY) ## The site in build/site/html, its notebooks run, and every command and code block of the documents
	@$(MAKE) --no-print-directory -j2 --output-sync=target site document-tests

site: $(READY) ## The site alone, in build/site/html: about a minute
	@PYTHONPATH=deploy/site $(BIN)/python -m rpod_site

document-tests: $(READY)
	$(BIN)/python -m pytest tests/documents -n 2 --dist worksteal $(ARGS)

viewers: $(INSTALLED)
	@bash deploy/viewers.sh $(VENV)

check-viewers: $(READY) viewers ## A log and a report in other people's readers and viewers; gets what it needs
	$(BIN)/python -m pytest tests/viewers $(ARGS)

bench: $(READY) ## Measured speed of this machine
	$(BIN)/python -m rpod bench $(ARGS)

reading: $(READY) ## A log of 10 GB: time to open and slice it, memory to summarise it
	@PYTHONPATH=benchmarks $(BIN)/python -m long_log $(ARGS)

fuzz: $(READY) ## Hostile input of every kind, for MINUTES: readers in one process, then the facility over the bus
	-@$(BIN)/python -m pip install --quiet --group fuzz
	@PYTHONPATH=tests $(BIN)/python -m fuzz $(MINUTES) $(ARGS)

kills: $(READY) ## Each service of a facility killed 100 times (ARGS="--count 10"): when it works again, what the log says
	@PYTHONPATH=benchmarks $(BIN)/python -m endurance kills $(ARGS)

soak: $(READY) ## A facility for an hour (ARGS="--hours 8"): memory, threads, descriptors, latency beside a bare echo
	@PYTHONPATH=benchmarks $(BIN)/python -m endurance soak $(ARGS)

recording: $(READY) ## The logger at a camera's full rate: loss, processor time, memory
	@PYTHONPATH=benchmarks $(BIN)/python -m recording $(ARGS)

busy: $(READY) ## A run beside two busy processes: what its log misses
	@PYTHONPATH=benchmarks $(BIN)/python -m busy $(ARGS)

cluster: $(READY) ## A campaign on a Dask cluster of this machine beside the process pool, in pairs
	@PYTHONPATH=benchmarks $(BIN)/python -m cluster $(ARGS)

hand-eye: $(READY) ## Errors of mount and clock calibrations on emulated minutes
	@PYTHONPATH=benchmarks $(BIN)/python -m hand_eye $(ARGS)

truth-error: $(READY) ## NEES of logs beside a truth with errors: make truth-error ARGS="runs/*/*.mcap"
	@PYTHONPATH=benchmarks $(BIN)/python -m truth_error $(ARGS)

free-flight: $(READY) ## Predictions through gaps, on synthetic measurements
	@PYTHONPATH=benchmarks $(BIN)/python -m free_flight $(ARGS)

peers: $(PEERS)/.ready ## Registration packages beside our methods, on the same scans
	@OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 PYTHONPATH=benchmarks $(PEERS)/bin/python -m peers $(ARGS)

$(PEERS)/.ready: pyproject.toml constraints.txt deploy/setup.sh deploy/peers.sh
	bash deploy/peers.sh $(PEERS)
	@touch $@

lock: $(READY) ## The lock with hashes, the bill of materials and the licences, made anew; needs a network
	$(BIN)/python -m pip install --quiet --group release
	$(BIN)/uv pip compile pyproject.toml --extra all --universal --python-version 3.11 --constraint constraints.txt --generate-hashes \
	  --no-emit-index-url --no-header --annotation-style line --quiet -o deploy/supply/requirements.lock
	$(BIN)/python deploy/supply/make_sbom.py

audit: $(READY) ## Known weaknesses of the locked packages; needs a network
	$(BIN)/python -m pip install --quiet --group release
	$(BIN)/pip-audit --require-hashes --disable-pip -r deploy/supply/requirements.lock

clean: ## Remove the virtual environments and caches
	rm -rf $(VENV) $(PEERS) tests/viewers/node_modules .mypy_cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache
