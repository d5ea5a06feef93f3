# `make` alone lists the targets. A fresh clone needs Python >= 3.11 with venv, and nothing else. From Python 3.13 on
# it needs redis-server too, because none is bundled: without one, an older Python is taken where there is one.
PYTHON ?= $(shell command -v redis-server >/dev/null || command -v valkey-server >/dev/null \
	|| ! python3 -c 'import sys; sys.exit(sys.version_info < (3, 13))' 2>/dev/null && echo python3 \
	|| command -v python3.12 || command -v python3.11 || echo python3)
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
export OMP_NUM_THREADS ?=
ifeq ($(OMP_NUM_THREADS),)
unexport OMP_NUM_THREADS
endif
# Compiled code is kept, whatever the environment says: else each of many processes compiles all of it anew.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help

help: ## list the targets
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(None if sys.version_info >= (3, 11) else "WIBAM needs Python 3.11 or newer; set PYTHON=")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt torch
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	$(BIN)/python -m compileall -q -j 0 api worker wibam_core
	@touch $@

setup: $(READY) ## make the virtual environment and install everything into it

demo: $(READY) ## record a simulated intersection, upload it, fine-tune on it and show what came out (about 6 minutes)
	$(BIN)/wibam demo --out build/demo

serve: $(READY) ## keep the service up for your own footage, on this machine alone
	$(BIN)/wibam serve

test: lint ## lint, check types and import directions, run the tests without those of whole services and browsers
	$(MAKE) --jobs=2 types quick-tests

test-all: lint ## the same with the tests of whole services and browsers, too
	$(MAKE) --jobs=2 types all-tests

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

# beside the tests: it takes one core for long
types: $(READY)
	$(BIN)/mypy

# who is idle takes tests over from the other, so that both end together
PYTEST := $(BIN)/python -m pytest -n 2 --dist worksteal

quick-tests: $(READY)
	$(PYTEST) -m "not end_to_end"

all-tests: $(READY)
	$(PYTEST)

READERS := build/readers
$(READERS)/.ready: tests/readers/requirements.txt
	$(PYTHON) -m venv $(READERS)
	$(READERS)/bin/python -m pip install --quiet --disable-pip-version-check -r tests/readers/requirements.txt
	@touch $@

test-readers: $(READERS)/.ready ## let other projects' programs read what is exported, in an environment of their own
	$(READERS)/bin/python -m pytest -p no:cacheprovider tests/readers

mutants: $(READY) ## write mistakes into a copy of the core and see which the tests notice (about 15 minutes)
	$(BIN)/python -m benchmarks.mutants --random 40

fix: $(READY) ## format the code and mend what the linter can mend
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

weights: $(READY) ## train the bundled networks again from simulated images (hours without a GPU): build/weights
	$(BIN)/python -m wibam_core.pretraining.detector --out build/weights/plain --steps 3000 --images 1200 --varied 0
	$(BIN)/python -m wibam_core.pretraining.detector --out build/weights/varied --steps 5000 --images 3000 --seed 3000 \
		--workers 1 --varied 6 --start build/weights/plain/detector2d.onnx
	$(BIN)/python -m wibam_core.pretraining.detector --out build/weights/near --steps 3000 --images 1400 --seed 10000 \
		--workers 1 --varied 7 --near 0.6 --learning-rate 1.5e-3 --start build/weights/varied/detector2d.onnx
	$(BIN)/python -m wibam_core.pretraining.detector --out build/weights --steps 6000 --images 3200 --seed 20000 \
		--workers 1 --varied 8 --near 0.5 --learning-rate 1.5e-3 --start build/weights/near/detector2d.onnx
	$(BIN)/python -m wibam_core.pretraining.edge_refiner --out build/weights/plain_refiner --steps 5000 --images 4000 \
		--workers 1 --varied 0
	$(BIN)/python -m wibam_core.pretraining.edge_refiner --out build/weights/edge_refiner --steps 6000 --images 3600 \
		--seed 20000 --workers 1 --varied 6 --near 0.4 --learning-rate 1.5e-3 --start build/weights/plain_refiner/edge_refiner.onnx
	$(BIN)/python -m wibam_core.pretraining.monocular --out build/weights/1 --steps 9500 --images 42000 --shard 280 \
		--batch 32 --learning-rate 2.5e-3 --seed 30000 --rendered 544 384 --zoom 0.7 1.45 --checkpoint-every 2000 \
		--device auto --workers 14
	$(BIN)/python -m wibam_core.pretraining.monocular --out build/weights/2 --steps 3300 --images 14000 --shard 240 \
		--batch 32 --learning-rate 1.2e-3 --seed 80000 --rendered 544 384 --zoom 0.7 1.45 --checkpoint-every 1100 \
		--device auto --workers 12 --start build/weights/1/mono_small.safetensors

clean: ## remove what was built; the virtual environment stays
	rm -rf build .mypy_cache .ruff_cache .pytest_cache .import_linter_cache

.PHONY: help setup demo serve test test-all lint types quick-tests all-tests test-readers mutants fix weights clean
