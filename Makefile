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
SLOW = $(foreach name,shift_and_sum_nearest shift_and_sum_cubic shift_and_sum_exact fourier_slice_linear \
	shift_and_sum_fill shift_and_sum_cubic_fill exact_fourier_fill disparity_layers wiener,~methods.$(name))
# More arguments for pip, for example PIP_ARGS="--extra-index-url https://download.pytorch.org/whl/cpu".
PIP_ARGS ?=

export PYTHONWARNINGS ?= ignore::FutureWarning
# Material for MkDocs advertises its successor otherwise.
export NO_MKDOCS_2_WARNING ?= 1

.PHONY: help install demo test figures paper ablations gpu weights lint site quick fuzz clean

help:
	@echo "make demo [INPUT=LIGHT_FIELD]   train, evaluate, refocus and bench; ends in two pages"
	@echo "make test                       linters, types, import layers, the site and all tests"
	@echo "make site                       the pages and the reference as a site, in runs/site"
	@echo "make figures                    measure the figures of README and docs again"
	@echo "make paper                      the paper's experiments, against the truth; goes on where it was stopped"
	@echo "make ablations                  which of the paper's choices matter; goes on where it was stopped"
	@echo "make gpu [MINUTES=10]           what needs a GPU: tests, benches, the paper's network; goes on where it was stopped"
	@echo "make weights                    train the networks that ship again"
	@echo "make quick                      the tests that take no more than seconds"
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
	$(BIN)/lfref eval "$(DEMO)/scenes" run="$(DEMO)/refnet_demo" truth="$(DEMO)/scenes/truth" output="$(DEMO)/eval"
	$(BIN)/lfref refocus "$(FIELD)" run="$(DEMO)/refnet_demo" output="$(DEMO)/refocus_refnet"
	$(BIN)/lfref refocus "$(FIELD)" method=shift_and_sum output="$(DEMO)/refocus_shift_and_sum"
	$(BIN)/lfref refocus "$(FIELD)" method=learned planes=paper output="$(DEMO)/refocus_learned"
	$(BIN)/lfref bench "$(FIELD)" run="$(DEMO)/refnet_demo" $(if $(INPUT),,truth="$(DEMO)/evening/truth") output="$(DEMO)/bench" repeats=2 $(SLOW)
	$(BIN)/lfref report $(foreach run,eval refocus_refnet bench refnet_demo refocus_learned refocus_shift_and_sum,"$(DEMO)/$(run)") output="$(DEMO)/report" title="lfref demo" 'text="$(DEMO_TEXT)"'
	$(BIN)/lfref view "$(FIELD)" output="$(DEMO)/view"

figures: $(VENV)/checks
	$(BIN)/lfref bench checkpoint=lfref/weights/refnet.safetensors overwrite=true output=runs/figures/bench repeats=5
	$(BIN)/lfref bench wide=false correct=white 'test_scenes=[bokeh,vignetting,colours,misaligned,crosstalk,grainy,graded,everything]' overwrite=true output=runs/figures/white repeats=1
	$(BIN)/lfref bench test_scenes=[] wide=false varied=60 overwrite=true output=runs/figures/varied repeats=1
	$(BIN)/lfref bench group=causes overwrite=true output=runs/figures/causes
	$(BIN)/lfref bench group=operators overwrite=true output=runs/figures/operators repeats=5
	$(BIN)/lfref bench group=simulate overwrite=true output=runs/figures/simulate repeats=2
	$(BIN)/lfref bench group=data overwrite=true output=runs/figures/data
	$(BIN)/lfref bench group=engines overwrite=true output=runs/figures/engines
	$(BIN)/lfref bench group=stability overwrite=true output=runs/figures/stability
	$(BIN)/python docs/scale.py
	$(BIN)/python docs/busy.py
	$(BIN)/python docs/prepared.py
	$(BIN)/python docs/exported.py
	$(BIN)/python docs/browsing.py
	$(BIN)/python docs/training_speed.py
	$(BIN)/python docs/paper_speed.py
	$(BIN)/python docs/living.py --film
	$(BIN)/python docs/measure.py
	$(BIN)/python docs/pictures.py

paper: install
	$(BIN)/python docs/paper.py
	$(BIN)/python docs/paper_speed.py

ablations: install
	$(BIN)/python docs/ablations.py

# What needs a GPU, ten minutes at a time: make gpu MINUTES=30. Goes on where it was stopped.
gpu: install
	$(BIN)/python docs/gpu.py --minutes $(or $(MINUTES),10)

# The networks that ship, from nothing, in hours. The same words go on where they were interrupted.
weights: install
	$(BIN)/lfref prepare output="$(WEIGHTS)/set_$(shell date +%s)"
	if [ -e "$(WEIGHTS)/run/checkpoints" ]; then $(BIN)/lfref train resume="$(WEIGHTS)/run"; \
	else $(BIN)/lfref train experiment=refiner output="$(WEIGHTS)/run"; fi
	$(BIN)/python docs/weights.py learned "$(WEIGHTS)/run"
	for label in shift_and_sum fourier_slice; do \
		$(BIN)/lfref train experiment=refnet label=$$label resume=auto output="$(WEIGHTS)/$$label" || exit 1; done
	$(BIN)/python docs/weights.py refnet "$(WEIGHTS)/shift_and_sum"
	$(BIN)/lfref train experiment=refnet_truth resume=auto output="$(WEIGHTS)/rendered"

lint: install
	$(BIN)/ruff check lfref tests docs/*.py
	$(BIN)/ruff format --check lfref tests docs/*.py
	$(BIN)/mypy
	$(BIN)/lint-imports

site: install
	$(BIN)/mkdocs build --strict

# Triton's interpreter runs the GPU's kernel on the CPU, line by line; Mitsuba renders what the simulator is checked by;
# the engines of `export` run what PyTorch runs; `serve` is the server of a page; `dashboard` specifies panels.
$(VENV)/checks: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check $(PIP_ARGS) --constraint constraints.txt --editable '.[triton,mitsuba,export,serve,dashboard]'
	touch $@

test: lint site $(VENV)/checks
	$(BIN)/python -m pytest -n auto

quick: install
	$(BIN)/python -m pytest -n auto -m "not slow"

fuzz: $(VENV)/checks
	$(BIN)/python -m pytest -n auto -m hypothesis --hypothesis-profile=fuzz

clean:
	rm -rf runs outputs multirun .pytest_cache .ruff_cache .mypy_cache .hypothesis
