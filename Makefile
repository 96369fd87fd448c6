# Everything runs in .venv, which the first command that needs it creates.
PROFILE ?= demo
VENV := .venv
RUN := $(VENV)/bin/python -m artifact
# The first Python that fits: python3 if it does, else a named version.
PYTHON ?= $(shell for p in python3 python3.12 python3.13 python3.11; do \
	$$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null && echo $$p && break; done)
PIP := $(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-compile
UNCOMPILED := not all could be compiled now: it is compiled at first use
ON = $(if $(CLUSTER),--cluster $(CLUSTER))
# As typed: spaces, quotes and dollar signs reach the command unchanged.
export ARTIFACT_SET := $(value SET)
export ARTIFACT_RECOMPUTE := $(value RECOMPUTE)
# Memory of a layer or matrix is kept for the next: given back and cleared each time, it takes a third of the time of the model.
export MALLOC_MMAP_THRESHOLD_ ?= 268435456
export MALLOC_TRIM_THRESHOLD_ ?= 536870912
SHELL := /bin/sh
# An environment that moved with its clone still points at the old place: it is made again.
$(shell test -f $(VENV)/.ready && test "$$(cat $(VENV)/.ready)" != "$$(pwd)" && rm -f $(VENV)/.ready)
.DEFAULT_GOAL := help
.PHONY: help doctor setup reproduce rehearsal test lab book data extract verify bench plan cluster-example status torture lint mutants lock clean \
	results-export results-import

help: ## show this help
	@echo "make reproduce            set up, run the demo, build the book (all that a first run needs)"
	@echo "make test                 set up, run all tests"
	@echo
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | awk -F'\t' '{printf "  %-15s %s\n", $$1, $$2}'
	@echo
	@echo "PROFILE=demo              profile of data_manifest.yaml for reproduce, data, extract, plan, verify, status"
	@echo "SET='k=5 fig06.seed=1'    notebook parameters for reproduce, for all notebooks or one"
	@echo "DATASET='nordland svox'   data: obtain and prepare these; SET='poses=ins' sets parameters of the preparation"
	@echo "DEVICES=cuda:0,cuda:1     devices of extract and plan (all: every CUDA device); PRECISION=bfloat16 mixed precision"
	@echo "CLUSTER=local|slurm|tcp://…  workers of reproduce and extract; WORKERS='1 64' GPUS=8 with plan: foretell the schedule"
	@echo "RECOMPUTE='DATASET x METHOD'  with verify: compute it anew from images, compare with what is stored or imported"
	@echo "METHODS='all'             bench: time the paper's methods (or those named), for Table II"
	@echo "TORCH_INDEX=URL           index of set-up's PyTorch, for example of its CPU builds"
	@echo "ARTIFACT_DATA_ROOT=DIR    folder of the real datasets; ARTIFACT_CACHE=DIR folder of stored results"

doctor: ## check in a second what set-up needs, and say what is wrong
	@$(or $(PYTHON),python3) src/artifact/commands/doctor.py

setup: $(VENV)/.ready ## create the environment only

reproduce: $(VENV)/.ready ## run the notebooks of a profile where anything changed, build the book
	@$(RUN) reproduce --profile $(PROFILE) --set "$$ARTIFACT_SET" $(ON)

rehearsal: $(VENV)/.ready ## the whole paper on made descriptors: every page, no result
	@$(RUN) reproduce --profile rehearsal $(ON)

test: $(VENV)/.ready ## run all tests
	@$(VENV)/bin/python -m pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder $(ARGS)

lab: $(VENV)/.ready ## open the notebooks in JupyterLab, to tweak them (installs it on first use)
	@$(VENV)/bin/python -c 'import jupyterlab' 2>/dev/null || { echo "installing JupyterLab into $(VENV) (a minute, once)"; \
		$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --editable '.[lab]'; }
	@$(VENV)/bin/jupytext --quiet --sync notebooks/*.py
	@cd notebooks && ../$(VENV)/bin/jupyter lab

book: $(VENV)/.ready ## build the book from the executed notebooks, running none
	@$(RUN) book

data: $(VENV)/.ready ## make datasets and weights of a profile ready; with DATASET=robotcar obtain and prepare that one
	@$(RUN) data $(if $(DATASET),--dataset $(DATASET) --set "$$ARTIFACT_SET",--profile $(PROFILE))

extract: $(VENV)/.ready ## extract the descriptors of a profile; with DRY_RUN=1 say what that takes
	@$(RUN) extract --profile $(PROFILE) $(if $(filter-out 0 no,$(DRY_RUN)),--dry-run) \
		$(if $(DEVICES),--devices $(DEVICES)) $(if $(PRECISION),--precision $(PRECISION)) $(ON)

verify: $(VENV)/.ready ## check stored results and measurements against the paper; with REPAIR=1 make what is damaged anew
	@$(RUN) verify --profile $(PROFILE) $(if $(filter-out 0 no,$(REPAIR)),--repair) \
		$(if $(RECOMPUTE),--recompute "$$ARTIFACT_RECOMPUTE")

results-export: $(VENV)/.ready ## write BUNDLE, the results that the pages of a profile read, to build its book elsewhere
	@$(RUN) results export "$(or $(BUNDLE),$(PROFILE).zip)" --profile $(PROFILE)

results-import: $(VENV)/.ready ## read BUNDLE, the results of another machine
	@$(RUN) results import "$(or $(BUNDLE),$(PROFILE).zip)"

bench: $(VENV)/.ready ## time ranking and extraction on this machine
	@$(RUN) bench $(if $(METHODS),--methods $(filter-out all,$(METHODS)))

plan: $(VENV)/.ready ## say what a whole run of a profile takes on this machine: time, memory, disk
	@$(RUN) plan --profile $(PROFILE) $(if $(DEVICES),--devices $(DEVICES)) \
		$(if $(WORKERS),--workers $(WORKERS) $(if $(GPUS),--gpus $(GPUS)))

cluster-example: $(VENV)/.ready ## write cluster.yaml, the options of queueing systems, to fill in
	@$(RUN) cluster-example

status: $(VENV)/.ready ## show what is ready and what is missing
	@$(RUN) status --profile $(PROFILE)

torture: $(VENV)/.ready ## kill runs 1,000 times at any step and damage 500 files: nothing wrong, nothing lost (some 10 minutes)
	@$(VENV)/bin/python tests/torture.py $(ARGS)

lint: $(VENV)/.ready ## check style, format, types, dead code and the order of imports
	@$(VENV)/bin/ruff check . && $(VENV)/bin/ruff format --check .
	@$(VENV)/bin/mypy && $(VENV)/bin/vulture
	@$(VENV)/bin/python -m pytest -q tests/test_architecture.py

mutants: $(VENV)/.ready ## for maintainers: small changes of the library that tests must notice; AREAS='store ranking' SAMPLE=40
	@$(VENV)/bin/python -c 'import cosmic_ray' 2>/dev/null || \
		$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --editable '.[mutants]'
	@$(VENV)/bin/python -W ignore tests/mutants.py $(AREAS) $(if $(SAMPLE),--sample $(SAMPLE))

# torch, and what only its CUDA build needs, stay out: CPU and CUDA builds have different files.
UNLOCKED := torch triton cuda-bindings cuda-pathfinder cuda-toolkit nvidia-cublas nvidia-cuda-cupti nvidia-cuda-nvrtc \
	nvidia-cuda-runtime nvidia-cudnn-cu13 nvidia-cufft nvidia-cufile nvidia-curand nvidia-cusolver nvidia-cusparse \
	nvidia-cusparselt-cu13 nvidia-nccl-cu13 nvidia-nvjitlink nvidia-nvshmem-cu13 nvidia-nvtx
lock: ## resolve environment.txt anew from pyproject.toml (needs uv)
	@uv pip compile pyproject.toml --extra test --universal --python-version 3.11 --fork-strategy fewest --generate-hashes \
		$(addprefix --no-emit-package ,$(UNLOCKED)) --no-annotate --no-header --quiet --upgrade --output-file environment.txt

clean: ## delete stored results and the built book, not the environment
	rm -rf .cache book/_build book/executed

# Of two commands that set up at once, the second waits; the file that is locked is one that is always there.
define ONE_AT_A_TIME
import fcntl, os, sys
lock = os.open("Makefile", os.O_RDONLY)
os.set_inheritable(lock, True)
try:
    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
except BlockingIOError:
    print("another command sets up this folder: waiting for it", flush=True)
    fcntl.flock(lock, fcntl.LOCK_EX)
except OSError:
    pass  # a file system without locks
os.execvp(sys.argv[1], sys.argv[1:])
endef
export ONE_AT_A_TIME

$(VENV)/.ready: environment.txt pyproject.toml
	@test -n "$(PYTHON)" || { echo "error: Python 3.11, 3.12 or 3.13 is needed and not found; name it with PYTHON=/path/to/python" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(None if (3, 11) <= v <= (3, 13) else "error: Python 3.11, 3.12 or 3.13 is needed, $(PYTHON) is %d.%d" % v)'
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { echo "error: $(PYTHON) has no venv module; on Debian and Ubuntu: apt install python3-venv" >&2; exit 1; }
ifndef LOCKED
	@$(PYTHON) -c "$$ONE_AT_A_TIME" $(MAKE) --no-print-directory LOCKED=1 $@
else
	@echo "creating $(VENV) (a few minutes the first time)"
	@test -n "$(TORCH_INDEX)" || test "$$(uname)" != Linux || command -v nvidia-smi >/dev/null 2>&1 || \
		echo "no NVIDIA driver here: if PyTorch comes as its CUDA build (3 GB), TORCH_INDEX=URL takes the CPU build of another index (0.2 GB)"
	@$(PYTHON) -m venv --clear $(VENV)
	@$(PIP) torch==2.13.0 $(if $(TORCH_INDEX),--index-url $(TORCH_INDEX))
	@awk '/^[a-z]/ { on = /^(llvmlite|numba|numpy|pillow|scipy)==/ } on' environment.txt > $(VENV)/first.txt
	@$(PIP) --no-deps --require-hashes -r $(VENV)/first.txt
	@# The installer takes one core: beside it the renderer is compiled, and the rest when all is there.
	@# uv reads none of pip's settings: where pip has an index, proxy or certificate and uv has none, pip installs.
	@PYTHONPATH=src $(VENV)/bin/python -m artifact_city & city=$$!; trap "kill $$city" INT TERM; \
	if command -v uv >/dev/null 2>&1 && { env | grep -q '^UV_' || \
		! $(VENV)/bin/python -m pip config list | grep -E '(index-url|proxy|cert|no-index|find-links)=' >/dev/null; }; then \
		uv pip install --quiet --python $(VENV)/bin/python --no-deps --require-hashes -r environment.txt; \
	else $(PIP) --no-deps --require-hashes -r environment.txt; fi; \
	installed=$$?; wait $$city || test $$installed -ne 0 || echo "$(UNCOMPILED)"; exit $$installed
	@$(PIP) --no-deps --no-build-isolation --editable .
	@$(VENV)/bin/python -m artifact.ranking & ranking=$$!; $(VENV)/bin/python -m compileall -qq -j 0 src $(VENV)/lib; \
		wait $$ranking || echo "$(UNCOMPILED)"
	@pwd > $@
endif
