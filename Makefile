# Everything runs in .venv, which `make setup` makes, as does each target that needs it.
PYTHON ?= python3
PRESET ?= default
WORKERS ?=
DATA ?= data
SET ?=
OUT ?=

VENV := .venv
READY := $(VENV)/.ready
RENDEZVOUS := $(VENV)/bin/rendezvous
# In our order, the longest files early; by itself xdist would put files of few tests last, which are these.
ON_ALL_CORES = -n logical --maxprocesses 8 --dist loadfile --no-loadscope-reorder
OPTIONS = --preset $(PRESET) --data $(DATA) $(if $(WORKERS),--workers $(WORKERS)) $(foreach item,$(SET),--set $(item))

.DEFAULT_GOAL := help
.PHONY: help setup dataset train train-pose inspect evaluate test test-fast check bench golden docs clean

help:  ## print this
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)
	@echo "  variables: PRESET=$(PRESET) (smoke, default, poses, pathtraced, large, paper), DATA=$(DATA), WORKERS=all cores,"
	@echo "             SET='explore.episodes_per_plan=10 ...', PYTHON=$(PYTHON), OUT=$(or $(OUT),runs/MODEL) (train's)"

setup: $(READY)  ## install everything into .venv

dataset: $(READY)  ## floor plans -> DATA/dataset, the Parquet dataset of rendezvous
	$(RENDEZVOUS) dataset $(OPTIONS)

train: $(READY)  ## train the default estimator on DATA/dataset, about 20 minutes; resumes after a kill
	$(RENDEZVOUS) train --resume $(OPTIONS) $(if $(OUT),--out $(OUT))

train-pose: $(READY)  ## train the relative-pose network on DATA/dataset, about an hour; resumes after a kill
	$(RENDEZVOUS) train-pose --resume $(OPTIONS) $(if $(OUT),--out $(OUT))

inspect: $(READY)  ## draw contact sheets of DATA/dataset to report/
	$(RENDEZVOUS) inspect $(DATA)/dataset

evaluate: $(READY)  ## measure relative pose, frame error and fusion on DATA/dataset, report to report/index.html
	$(RENDEZVOUS) evaluate-all --data $(DATA) $(if $(WORKERS),--workers $(WORKERS))

test: $(READY)  ## all tests, a file on each core at a time
	@PYTHON=$(PYTHON) .ci/system-packages test
	$(VENV)/bin/python -m pytest $(ON_ALL_CORES)

test-fast: $(READY)  ## tests that take seconds
	$(VENV)/bin/python -m pytest -m "not slow" $(ON_ALL_CORES)

check: $(READY)  ## format, lint, types, import contracts
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/ruff check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports

bench: $(READY)  ## speed of episodes, rendering, training, estimators and fuse, part by part, as JSON
	@$(VENV)/bin/python -m benchmarks

golden: $(READY)  ## accept a wanted change: rewrite tests/golden.json
	$(VENV)/bin/python -m tests.golden

docs: $(READY)  ## write the generated tables of README.md anew
	$(VENV)/bin/python -m rendezvous.documentation

clean:  ## remove .venv and caches; data stays
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache

$(READY): pyproject.toml constraints.txt
	@started=$$(date +%s); \
	PYTHON=$(PYTHON) .ci/system-packages && \
	$(PYTHON) -m venv $(VENV) && \
	$(VENV)/bin/python -m pip install --disable-pip-version-check -q -c constraints.txt -e '.[dev,learn]' && \
	touch $@ && \
	echo "set-up took $$(( $$(date +%s) - started )) s"
