# Every target sets up what it needs; `make help` lists them.
PYTHON ?= python3
WORKERS ?= 2
BIN := .venv/bin
OPENGL_PACKAGES := libegl1 libgl1-mesa-dri
BROWSER_PACKAGES := chromium
BROWSERS := chromium chromium-browser google-chrome google-chrome-stable
PARAVIEW_PACKAGES := paraview python3-paraview xvfb xauth
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS)

.DEFAULT_GOAL := help
.PHONY: docs schema help setup run report bench test test-web test-paraview browser quick fuzz lint clean

help: ## Show this list
	@echo "usage: make TARGET [PYTHON=python3.12] [WORKERS=4]"
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  %-13s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: .venv/installed ## Create .venv and install everything; as root on Debian or Ubuntu also the OpenGL libraries
	@if $(BIN)/python -m pipeline.system.opengl; then exit 0; fi; \
	line="apt-get install -y --no-install-recommends $(OPENGL_PACKAGES)"; \
	if [ "$$(id -u)" = 0 ] && [ -e /etc/debian_version ] && command -v apt-get >/dev/null; then \
		echo "installing OpenGL libraries: apt-get update && $$line"; \
		export DEBIAN_FRONTEND=noninteractive; \
		apt-get update -qq && $$line -qq >/dev/null && $(BIN)/python -m pipeline.system.opengl && exit 0; \
		echo "OpenGL could not be installed; continuing without pictures and movies"; \
	else \
		echo "continuing without pictures and movies; to get them on Debian or Ubuntu: sudo $$line"; \
	fi

run: setup ## Run the example: cases/bar.toml -> outputs/bar with report.html (solved again each time)
	$(BIN)/pipeline run cases/bar.toml --force
	$(BIN)/pipeline report outputs/bar

report: setup ## Run every scene in full -> outputs/reproduction.html and .md: published numbers beside ours
	OMP_NUM_THREADS=1 $(BIN)/pipeline reproduce --force
	for case in cases/*.toml; do $(BIN)/pipeline run $$case --quiet || exit 1; done

bench: setup ## Measure the cost of a step beside plain scipy, in one run; minutes
	$(BIN)/python -m benchmarks.scaling cases/bar_as_printed.toml cases/mushroom_as_printed.toml cases/armadillo_as_printed.toml \
		--cells 2x8x2 8x26x8 18x52x18 --out outputs/bench

test: setup browser lint ## Run lint, then all tests, as CI does
	$(PYTEST)

test-web: setup browser ## Run only the tests of the web page in a browser
	$(PYTEST) -m browser

browser: ## As root on Debian, install Chromium for the tests of the web page
	@for name in $(BROWSERS); do command -v $$name >/dev/null && exit 0; done; \
	line="apt-get install -y --no-install-recommends $(BROWSER_PACKAGES)"; \
	if [ "$$PIPELINE_SKIP_BROWSER" = 1 ]; then \
		echo "PIPELINE_SKIP_BROWSER=1: no browser is installed, the web page is NOT tested in one"; \
	elif [ "$$(id -u)" = 0 ] && [ -e /etc/debian_version ] && command -v apt-get >/dev/null; then \
		echo "installing a browser for the tests: apt-get update && $$line"; \
		export DEBIAN_FRONTEND=noninteractive; \
		apt-get update -qq && $$line -qq >/dev/null || echo "Chromium could not be installed"; \
	else \
		echo "no browser: the tests of the web page will fail; on Debian: sudo $$line (or PIPELINE_SKIP_BROWSER=1)"; \
	fi

test-paraview: setup ## Test reading and drawing in Debian's ParaView; as root, install it first (386 MB to download)
	@if ! command -v pvbatch >/dev/null || ! command -v xvfb-run >/dev/null || ! command -v xauth >/dev/null; then \
		line="apt-get install -y --no-install-recommends $(PARAVIEW_PACKAGES)"; \
		if [ "$$(id -u)" = 0 ] && [ -e /etc/debian_version ]; then \
			echo "installing ParaView: apt-get update && $$line"; \
			export DEBIAN_FRONTEND=noninteractive; apt-get update -qq && $$line -qq >/dev/null; \
		else echo "ParaView is missing; on Debian: sudo $$line" >&2; exit 1; fi; \
	fi
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q tests/paraview

quick: setup ## Run the tests that take at most a few seconds each
	$(PYTEST) -m "not slow"

fuzz: setup ## Try 10 000 bad inputs, 10 000 files of every layout, and 100 kills at random moments; minutes
	PIPELINE_FUZZ=10000 PIPELINE_KILLS=100 $(PYTEST) tests/formats/test_fuzz.py tests/formats/test_differential.py \
		tests/results/test_faults.py -k "files or differential or kill_9"

lint: .venv/installed ## Run ruff check, ruff format --check and mypy
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: setup ## Build the site into docs/_build/html; a warning is an error
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs docs/_build/html
	@echo "open docs/_build/html/index.html"

schema: setup ## Rewrite cases/case.schema.json and the tables of docs/case_files.md
	$(BIN)/python -m tools.write_schema

clean: ## Remove .venv, caches and build leftovers; results in outputs/ stay
	rm -rf .venv build dist docs/_build docs/_generated *.egg-info .pytest_cache .ruff_cache .mypy_cache .hypothesis
	find pipeline tests -type d -name __pycache__ -prune -exec rm -rf {} +

# Remade when the requirements change.
.venv/installed: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
		echo "Python 3.11 or newer is required; $(PYTHON) is $$($(PYTHON) --version 2>&1 | head -n 1)." \
			"Choose another one: make setup PYTHON=python3.12" >&2; exit 1; }
	@echo "installing into .venv (a minute or two)"
	@$(PYTHON) -m venv .venv || { \
		echo "the virtual environment could not be created; on Debian or Ubuntu: apt-get install python3-venv" >&2; exit 1; }
	@$(BIN)/python -m pip install -qq --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@
