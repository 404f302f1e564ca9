# Everything here works on a bare machine with make and Python 3.11 to 3.13 (with venv).
# The virtual environment lies inside the checkout; VENV=... puts it elsewhere.

VENV ?= .venv
OUT ?= out
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11; do \
	$$p -c 'import sys, venv, ensurepip; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' \
	>/dev/null 2>&1 && { command -v $$p; break; }; done)

BIN = $(VENV)/bin
# One BLAS thread a process: more make small matrices slower.
export OMP_NUM_THREADS = 1
export OPENBLAS_NUM_THREADS = 1
export MKL_NUM_THREADS = 1

DEMO_LOG = datasets/ring/log.mcap
DATASETS = ring room_corridor room
SCHEMAS = model report eval reference summary jobs

.PHONY: help setup demo batch test test-slow lint format types bench real sensitivity ablation datasets schemas clean

help:
	@echo "make demo       set up, then build the models of $(DEMO_LOG) into $(OUT)/demo"
	@echo "make batch      run and evaluate the shipped data sets, with limits, into $(OUT)/batch"
	@echo "make test       set up, then run the tests"
	@echo "make test-slow  the tests that take minutes: Monte Carlo, long logs"
	@echo "make lint       ruff, rules and format;   make format  puts the format right"
	@echo "make types      mypy --strict"
	@echo "make bench      speed and memory, as JSON in $(OUT)/bench.json"
	@echo "make real       every real log of ../shared/data where it is present, one table"
	@echo "make sensitivity  every threshold moved by a fifth, into docs/sensitivity.md; an hour or two"
	@echo "make ablation   each part of the method left out, into docs/ablation.md; ten minutes"
	@echo "make datasets   simulate the logs of datasets/ anew"
	@echo "make schemas    write the JSON Schemas anew from the shapes of the documents"
	@echo "make clean      remove the virtual environment and everything made"

$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "no Python 3.11 to 3.13 with venv found; install one, or say PYTHON=/path/to/python3" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.runtime: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	@touch $@

$(VENV)/.development: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@ $(VENV)/.runtime

setup: $(VENV)/.development

demo: $(VENV)/.runtime
	$(BIN)/hiermap run $(DEMO_LOG) -o $(OUT)/demo --force
	@echo "the results are in $(OUT)/demo; open $(OUT)/demo/map.svg to look at the map"

batch: $(VENV)/.runtime
	$(BIN)/hiermap batch datasets/jobs.yaml -o $(OUT)/batch

test: $(VENV)/.development
	$(BIN)/python -m pytest -m "not slow and not bench" -n auto --dist loadfile

test-slow: $(VENV)/.development
	$(BIN)/python -m pytest -m slow

lint: $(VENV)/.development
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(VENV)/.development
	$(BIN)/ruff format .

types: $(VENV)/.development
	$(BIN)/mypy

bench: $(VENV)/.development
	@mkdir -p $(OUT)
	$(BIN)/python -m pytest -m bench --benchmark-json=$(OUT)/bench.json

real: $(VENV)/.development
	$(BIN)/python tests/real/table.py

sensitivity: $(VENV)/.development
	$(BIN)/python tests/real/sensitivity.py

ablation: $(VENV)/.development
	$(BIN)/python tests/real/ablation.py

datasets: $(VENV)/.runtime
	for name in $(DATASETS); do \
		$(BIN)/hiermap simulate datasets/$$name.yaml -o datasets/$$name --seed 1 --force || exit 1; \
	done

schemas: $(VENV)/.runtime
	for name in $(SCHEMAS); do \
		$(BIN)/python -c "from hiermap_cli.documents.schema import schema_text; \
	print(schema_text('$$name'), end='')" > hiermap_cli/documents/schemas/$$name.json || exit 1; \
	done

clean:
	rm -rf $(VENV) $(OUT) build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks
