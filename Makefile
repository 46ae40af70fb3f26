# Every target sets up what it needs first: in a fresh clone nothing else has to be typed.
SHELL := /bin/bash
READY := .venv/.ready
BIN := .venv/bin

.DEFAULT_GOAL := help
.PHONY: help setup demo reproduce test test-fast lint docs readme doctor

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /make \1\t/p' Makefile | expand -t 16

setup: ## install everything into .venv (and system packages, as root on Debian)
	scripts/setup.sh

demo: $(READY) ## collect, segment, train and evaluate one task
	$(BIN)/python scripts/demo.py

TABLE ?= 1
SIZE ?= cpu
JOBS ?= 2
reproduce: $(READY) ## run a table of the paper: TABLE=1 to 4, SIZE=smoke, cpu, gpu or paper, JOBS=2
	$(BIN)/python scripts/reproduce.py --experiments='[table$(TABLE)]' --size=$(SIZE) --jobs=$(JOBS)

# Files, not tests, go to the processes: those of a file share what they record and train. In their order: files of few tests
# take long, and would otherwise come last, when nobody shares the work.
TEST := $(BIN)/python -m pytest --numprocesses=auto --dist=loadfile --no-loadscope-reorder

test: $(READY) ## run all tests, on all cores
	$(TEST)

test-fast: $(READY) ## run the tests that neither simulate for long nor train
	$(TEST) -m "not slow"

lint: $(READY) ## check style, types and import directions
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(READY) ## build the site into outputs/site
	$(BIN)/uv run --python $(BIN)/python --frozen --isolated --only-group docs mkdocs build --strict

readme: $(READY) ## run every command of README on a dataset that the first ones make
	$(BIN)/python scripts/run_docs.py README.md

doctor: $(READY) ## check the installation
	$(BIN)/lerobot-buds-doctor

$(READY): pyproject.toml uv.lock scripts/setup.sh
	scripts/setup.sh
