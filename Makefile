# demo, test, test-all, lint, extension, clean. Each sets up .venv first; the second time that costs nothing.

VENV := .venv
BIN := $(VENV)/bin
# Blender 4.5's Python module needs exactly 3.11.
PYTHON ?= python3.11
# Installed first, and pinned, so that a CPU wheel of exactly this version on pip's path is taken. Where pip would
# fetch a CUDA build instead (Linux, plain PyPI) and you want none:
#   make TORCH='torch==2.13.0+cpu --extra-index-url https://download.pytorch.org/whl/cpu' …
TORCH ?= torch==2.13.0
# One thread in each of two workers is faster here than two threads in one.
WORKERS ?= 2
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile

.PHONY: demo test test-all test-slow lint extension install clean distclean

demo: install
	$(BIN)/tg4mm demo --out demo

test: lint
	$(PYTEST) -m "not slow"

# pytest leaves with 5 when no test is marked slow.
test-slow: install
	$(PYTEST) -m slow || [ $$? -eq 5 ]

test-all: test test-slow

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# dist/tg4mm-<version>.zip, for Blender's Edit > Preferences > Get Extensions > Install from Disk.
extension: install
	$(BIN)/python addon/make_extension.py

install: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml Makefile
	@$(PYTHON) -c 'import sys; assert sys.version_info[:2] == (3, 11)' 2>/dev/null || { \
		echo "$(PYTHON) is not Python 3.11, which Blender's Python module needs." >&2; \
		echo "Install it (Debian: apt-get install python3.11 python3.11-venv) or say where: make PYTHON=/path" >&2; \
		exit 2; }
	[ -x $(BIN)/python ] || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet $(TORCH)
	$(BIN)/python -m pip install --quiet -e '.[core,generate,dev]'
	@touch $@

clean:
	rm -rf build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .numba_cache
	find . -name __pycache__ -not -path './$(VENV)/*' -prune -exec rm -rf {} +

distclean: clean
	rm -rf $(VENV) demo
