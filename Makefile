# Everything runs in .venv, which the first command that needs it creates.
PROFILE ?= demo
VENV := .venv
RUN := $(VENV)/bin/python -m artifact
# The first Python that fits: python3 if it does, else a named version.
PYTHON ?= $(shell for p in python3 python3.12 python3.13 python3.11; do \
	$$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null && echo $$p && break; done)
# As typed: spaces, quotes and dollar signs reach the command unchanged.
export ARTIFACT_SET := $(value SET)
SHELL := /bin/sh
# An environment that moved with its clone still points at the old place: it is made again.
$(shell test -f $(VENV)/.ready && test "$$(cat $(VENV)/.ready)" != "$$(pwd)" && rm -f $(VENV)/.ready)
.DEFAULT_GOAL := help
.PHONY: help doctor setup reproduce rehearsal test book data extract verify bench plan status lint lock clean

help: ## show this help
	@echo "make reproduce            set up, run the demo, build the book (all that a first run needs)"
	@echo "make test                 set up, run all tests"
	@echo
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | awk -F'\t' '{printf "  %-11s %s\n", $$1, $$2}'
	@echo
	@echo "PROFILE=demo              profile of data_manifest.yaml for reproduce, data, extract, plan, verify, status"
	@echo "SET='k=5 fig06.seed=1'    notebook parameters for reproduce, for all notebooks or one"
	@echo "DEVICES=cuda:0,cuda:1     devices of extract and plan (all: every CUDA device); PRECISION=bfloat16 mixed precision"
	@echo "METHODS='all'             bench: time the paper's methods (or those named), for Table II"
	@echo "TORCH_INDEX=URL           index of set-up's PyTorch, for example of its CPU builds"
	@echo "ARTIFACT_DATA_ROOT=DIR    folder of the real datasets; ARTIFACT_CACHE=DIR folder of stored results"

doctor: ## check in a second what set-up needs, and say what is wrong
	@$(or $(PYTHON),python3) src/artifact/commands/doctor.py

setup: $(VENV)/.ready ## create the environment only

reproduce: $(VENV)/.ready ## run the notebooks of a profile where anything changed, build the book
	@$(RUN) reproduce --profile $(PROFILE) --set "$$ARTIFACT_SET"

rehearsal: $(VENV)/.ready ## the whole paper on made descriptors: every page, no result
	@$(RUN) reproduce --profile rehearsal

test: $(VENV)/.ready ## run all tests
	@$(VENV)/bin/python -m pytest --numprocesses 2 --dist loadfile $(ARGS)

book: $(VENV)/.ready ## build the book from the executed notebooks, running none
	@$(RUN) book

data: $(VENV)/.ready ## make datasets and weights of a profile ready, say which are missing and how to obtain them
	@$(RUN) data --profile $(PROFILE)

extract: $(VENV)/.ready ## extract the descriptors of a profile; with DRY_RUN=1 say what that takes
	@$(RUN) extract --profile $(PROFILE) $(if $(filter-out 0 no,$(DRY_RUN)),--dry-run) \
		$(if $(DEVICES),--devices $(DEVICES)) $(if $(PRECISION),--precision $(PRECISION))

verify: $(VENV)/.ready ## check stored results against their sidecars and measurements against the paper
	@$(RUN) verify --profile $(PROFILE)

bench: $(VENV)/.ready ## time ranking and extraction on this machine
	@$(RUN) bench $(if $(METHODS),--methods $(filter-out all,$(METHODS)))

plan: $(VENV)/.ready ## say what a whole run of a profile takes on this machine: time, memory, disk
	@$(RUN) plan --profile $(PROFILE) $(if $(DEVICES),--devices $(DEVICES))

status: $(VENV)/.ready ## show what is ready and what is missing
	@$(RUN) status --profile $(PROFILE)

lint: $(VENV)/.ready ## check style, format, types, dead code and the order of imports
	@$(VENV)/bin/ruff check . && $(VENV)/bin/ruff format --check .
	@$(VENV)/bin/mypy && $(VENV)/bin/vulture
	@$(VENV)/bin/python -m pytest -q tests/test_architecture.py

# torch, and what only its CUDA build needs, stay out: CPU and CUDA builds have different files.
UNLOCKED := torch triton cuda-bindings cuda-pathfinder cuda-toolkit nvidia-cublas nvidia-cuda-cupti nvidia-cuda-nvrtc \
	nvidia-cuda-runtime nvidia-cudnn-cu13 nvidia-cufft nvidia-cufile nvidia-curand nvidia-cusolver nvidia-cusparse \
	nvidia-cusparselt-cu13 nvidia-nccl-cu13 nvidia-nvjitlink nvidia-nvshmem-cu13 nvidia-nvtx
lock: ## resolve environment.txt anew from pyproject.toml (needs uv)
	@uv pip compile pyproject.toml --extra test --universal --python-version 3.11 --fork-strategy fewest --generate-hashes \
		$(addprefix --no-emit-package ,$(UNLOCKED)) --no-annotate --no-header --quiet --upgrade --output-file environment.txt

clean: ## delete stored results and the built book, not the environment
	rm -rf .cache book/_build book/executed

$(VENV)/.ready: environment.txt pyproject.toml
	@test -n "$(PYTHON)" || { echo "error: Python 3.11, 3.12 or 3.13 is needed and not found; name it with PYTHON=/path/to/python" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(None if (3, 11) <= v <= (3, 13) else "error: Python 3.11, 3.12 or 3.13 is needed, $(PYTHON) is %d.%d" % v)'
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { echo "error: $(PYTHON) has no venv module; on Debian and Ubuntu: apt install python3-venv" >&2; exit 1; }
	@echo "creating $(VENV) (a few minutes the first time)"
	@$(PYTHON) -m venv --clear $(VENV)
	@$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check torch==2.13.0 $(if $(TORCH_INDEX),--index-url $(TORCH_INDEX))
	@# uv reads none of pip's settings: where pip has an index, proxy or certificate and uv has none, pip installs.
	@if command -v uv >/dev/null 2>&1 && { env | grep -q '^UV_' || \
		! $(VENV)/bin/python -m pip config list | grep -E '(index-url|proxy|cert|no-index|find-links)=' >/dev/null; }; then \
		uv pip install --quiet --python $(VENV)/bin/python --no-deps --require-hashes -r environment.txt; \
	else $(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes -r environment.txt; fi
	@$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@$(VENV)/bin/python -m artifact_city || echo "the renderer could not be compiled now: it is compiled at first use"
	@pwd > $@
