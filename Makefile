# Two commands on a fresh machine: `make demo` and `make test`. Both install what they need into .venv first.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
DEMO ?= runs/demo
# A light field to refocus in the demo: an ESLF image, a folder of views or an EXR file. Empty: a simulated one.
INPUT ?=
WEIGHTS ?= runs/weights
FIELD = $(or $(INPUT),$(DEMO)/evening/evening)
DEMO_TEXT = refnet_demo is a small RefNet that learned for half a minute on 80 simulated scenes. It shows that the network \
of the paper refocuses, not how well it can: method=refnet is one that learned for longer.
# Methods of `lfref bench` that the demo leaves out, to be short.
SLOW = $(foreach name,shift_and_sum_nearest shift_and_sum_cubic fourier_slice_linear \
	shift_and_sum_fill shift_and_sum_cubic_fill exact_fourier_fill disparity_layers,~methods.$(name))
# More arguments for pip, for example PIP_ARGS="--extra-index-url https://download.pytorch.org/whl/cpu".
PIP_ARGS ?=

export PYTHONWARNINGS ?= ignore::FutureWarning
# Material for MkDocs advertises its successor otherwise.
export NO_MKDOCS_2_WARNING ?= 1

.PHONY: help install demo test figures paper ablations gpu weights lint site test-slow fuzz clean

help:
	@echo "make demo [INPUT=LIGHT_FIELD]   train, evaluate, refocus and bench; ends in two pages"
	@echo "make test                       linters, types, import layers, and the tests that take seconds"
	@echo "make test-slow                  the site, and the tests that take longer"
	@echo "make site                       the pages and the reference as a site, in runs/site"
	@echo "make figures                    measure the figures of README and docs, in an hour; goes on where it was stopped"
	@echo "make paper                      the paper's experiments with the networks of 'make weights', against the truth"
	@echo "make ablations                  which of the paper's choices matter; goes on where it was stopped"
	@echo "make gpu [MINUTES=10]           what needs a GPU: tests, benches, the paper's network; goes on where it was stopped"
	@echo "make weights                    train the networks that ship again"
	@echo "make fuzz                       the tests of properties, by examples that are new at each run"
	@echo "make clean                      remove runs and caches of this checkout"

install: $(VENV)/installed

$(VENV)/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check $(PIP_ARGS) --constraint constraints.txt --editable '.[dev]'
	touch $@

demo: install
	rm -rf "$(DEMO)"
	$(BIN)/lfref simulate output="$(DEMO)/scenes" n_fields=4 scene.camera.size=[240,320] outputs=[views,truth] seed=2026
	$(if $(INPUT),,$(BIN)/lfref simulate scene=evening output="$(DEMO)/evening" outputs=[views,truth])
	$(BIN)/lfref train experiment=demo output="$(DEMO)/refnet_demo"
	$(BIN)/lfref eval "$(DEMO)/scenes" run="$(DEMO)/refnet_demo" truth="$(DEMO)/scenes" output="$(DEMO)/eval"
	$(BIN)/lfref refocus "$(FIELD)" run="$(DEMO)/refnet_demo" output="$(DEMO)/refocus_refnet"
	$(BIN)/lfref refocus "$(FIELD)" method=shift_and_sum output="$(DEMO)/refocus_shift_and_sum"
	$(BIN)/lfref refocus "$(FIELD)" method=blockwise_wiener planes=paper output="$(DEMO)/refocus_blockwise_wiener"
	$(BIN)/lfref bench "$(FIELD)" run="$(DEMO)/refnet_demo" $(if $(INPUT),,truth="$(DEMO)/evening") output="$(DEMO)/bench" repeats=2 $(SLOW)
	$(BIN)/lfref report $(foreach run,eval refocus_refnet bench refnet_demo refocus_blockwise_wiener refocus_shift_and_sum,"$(DEMO)/$(run)") output="$(DEMO)/report" title="lfref demo" 'text="$(DEMO_TEXT)"'
	$(BIN)/lfref view "$(FIELD)" output="$(DEMO)/view"

figures: $(VENV)/checks
	$(BIN)/python benchmarks/figures.py --measure
	$(BIN)/python benchmarks/pictures.py

paper: install
	$(BIN)/python benchmarks/paper.py

ablations: install
	$(BIN)/python benchmarks/ablations.py

# What needs a GPU, ten minutes at a time: make gpu MINUTES=30. Goes on where it was stopped.
gpu: install
	$(BIN)/python benchmarks/gpu.py --minutes $(or $(MINUTES),10)

# The network that ships, from nothing, in hours. The same words go on where they were interrupted.
weights: install
	$(BIN)/lfref train experiment=refnet label=shift_and_sum resume=auto output="$(WEIGHTS)/shift_and_sum"
	$(BIN)/python benchmarks/weights.py "$(WEIGHTS)/shift_and_sum"
	$(BIN)/lfref train experiment=refnet_truth label=fourier_slice resume=auto output="$(WEIGHTS)/fourier_slice"
	$(BIN)/lfref train experiment=refnet_truth resume=auto output="$(WEIGHTS)/rendered"

lint: install
	$(BIN)/ruff check lfref tests benchmarks/*.py site/*.py
	$(BIN)/ruff format --check lfref tests benchmarks/*.py site/*.py
	$(BIN)/mypy
	$(BIN)/lint-imports

site: install
	$(BIN)/mkdocs build --strict

# Mitsuba renders what the simulator is checked by.
$(VENV)/checks: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check $(PIP_ARGS) --constraint constraints.txt --editable '.[dev,mitsuba]'
	touch $@

test: lint $(VENV)/checks
	$(BIN)/python -m pytest -n auto -m "not slow"

# Pages in Chromium, SLURM, Mitsuba, the site, the wheel, long trainings, killed processes.
test-slow: site $(VENV)/checks
	$(BIN)/python -m pytest -n auto -m slow

fuzz: $(VENV)/checks
	$(BIN)/python -m pytest -n auto -m hypothesis --hypothesis-profile=fuzz

clean:
	rm -rf runs outputs multirun .pytest_cache .ruff_cache .mypy_cache .hypothesis
