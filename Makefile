# A newcomer needs two targets: `make demo` and `make test`. Both set everything up in .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# The embedded CPU device, unless the caller wants another one.
export CLRADAR_DEVICE ?= pocl
# Processes that run the tests. SLOWEST=20: which tests and fixtures took longest.
JOBS ?= 2
# Tests start many programs, and each would compile the package anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-spawn test-slow test-intel test-lowest nightly mutants fuzz fuzz-night memcheck gpucheck lint lint-windows size format figures validation docs links bench release clean

demo: $(VENV)/.installed
	$(BIN)/clradar demo --force -o demo

# There is a process for every core already: threads of BLAS would wait for each other.
test: export OPENBLAS_NUM_THREADS := 1
test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile $(if $(SLOWEST),--durations $(SLOWEST))

# With the readers of systems that cannot fork: a process is started for every file.
test-spawn: export CLRADAR_READERS := spawn
test-spawn: test

test-slow: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m slow --timeout 3600

# What runs on a device, on Intel's CPU runtime (260 MB, proprietary licence; AMD's processors too). It
# would become the default device, so it has an environment of its own.
test-intel: $(VENV)-intel/.installed
	CLRADAR_TEST_DEVICES=intel $(VENV)-intel/bin/python -m pytest -n $(JOBS) --dist loadfile -k intel

# Single faults in copies of the tree, and whether a test notices each (tests/mutants/mutants.toml): some
# twenty minutes. ONLY="tracing lobe": of these folders and files, or with ids that begin so.
mutants: $(VENV)/.installed-dev
	$(BIN)/python tests/mutants/run.py --jobs $(JOBS) $(ONLY)

# Everything that `.ci/run` leaves out, to be run over night. Each part has its own command, too.
nightly: lint-windows test-slow memcheck gpucheck test-spawn test-lowest test-intel mutants fuzz-night

# The oldest versions of the dependencies that pyproject.toml allows, in an environment of its own; with
# others that do not warn of what these use, since warnings are errors in the tests.
test-lowest: $(VENV)-lowest/.installed
	$(VENV)-lowest/bin/python -m pytest -n $(JOBS) --dist loadfile

# Mutated files for every reader: 100 000 of each take some hours, so that a night tries fewer, and
# others every day.
RUNS ?= 100000
SEED ?= 1
fuzz-night: RUNS = 10000
fuzz-night: SEED = $(shell date +%j)
fuzz-night: fuzz
fuzz: export PYTHONPATH := tests:tests/support
fuzz: $(VENV)/.installed-dev
	$(BIN)/python -c "from fuzz.targets import TARGETS; print(*TARGETS)" | \
		xargs -n 1 -P $(JOBS) $(BIN)/python -m fuzz --runs $(RUNS) --seed $(SEED)

# Oclgrind shows up as a device where it is installed, so it has an environment of its own.
memcheck: $(VENV)-memcheck/.installed
	$(VENV)-memcheck/bin/python -m pytest -m memcheck --timeout 3600 tests/opencl/test_memcheck.py \
		$(if $(LANES),-k "known_fault or $(LANES)")

# What compilers for GPUs make of the kernels, in an environment of its own (clang and ptxas from PyPI, 500 MB;
# no root, no GPU). Fails where it differs from the table in the repository; GPUCHECK=--write writes that.
gpucheck: $(VENV)-gpucheck/.installed
	$(VENV)-gpucheck/bin/python tests/support/gpu_check.py $(GPUCHECK)
	$(VENV)-gpucheck/bin/python -m pytest -q tests/opencl/test_gpu_check.py

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python packaging/size.py --check
	$(BIN)/mypy

# What differs between systems: only files that import one of these are checked as for Windows, too.
SYSTEM_MODULES := asyncio|ctypes|errno|fcntl|locale|mmap|msvcrt|multiprocessing|os|pathlib|resource|select|shutil|signal|socket|subprocess|sys|tempfile|threading|time|webbrowser
lint-windows: $(VENV)/.installed-dev
	$(BIN)/mypy --platform win32 --cache-dir .mypy_cache/win32 --follow-imports silent \
		$$(grep -rlE --include='*.py' --exclude=__init__.py '^ *(import|from) ($(SYSTEM_MODULES))\b' clradar measurement_io calibration)

# Lines of code by part, beside the budget that `make lint` holds.
size: $(VENV)/.installed
	$(BIN)/python packaging/size.py

format: $(VENV)/.installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# The figure of docs/index.md.
figures: $(VENV)/.installed
	$(BIN)/clradar demo --full --force -o demo-full
	cp demo-full/comparison.png docs/images/comparison.png

# docs/validation.md and its figures, against Mie, Kirchhoff theory and closed forms: some minutes.
validation: $(VENV)/.installed
	PYTHONPATH=tests $(BIN)/python -m truths

# build/site/index.html. Runs the tutorials whose files changed; DOCS=-Dplot_gallery=0 runs none.
docs: export OPENBLAS_NUM_THREADS := 1
docs: $(VENV)/.installed-docs
	$(BIN)/python -m sphinx -W --keep-going -b html -d build/doctrees $(DOCS) docs build/site

# Whether what the pages link to is there; needs a network.
links: $(VENV)/.installed-docs
	$(BIN)/python -m sphinx -q -b linkcheck -D sphinx_gallery_conf.plot_gallery=0 -d build/doctrees docs build/links

# Against peers, in turns, for ratios. BENCH=--quick takes three minutes.
bench: $(VENV)/.installed-bench
	$(BIN)/python benchmarks/against_peers.py $(BENCH)

# dist/: wheel and sdist, checked, and each tried in an environment of its own. Uploads nothing.
release:
	$(PYTHON) packaging/release.py

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: $(VENV)/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --editable .
	touch $@

# uv takes a fifth of pip's time; it does not know what pip is configured to, so pip goes on where it fails.
$(VENV)/.installed-dev: $(VENV)/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip install --quiet --python $(BIN)/python --editable ".[test,vtk,lint]" || \
		$(BIN)/python -m pip install --quiet --editable ".[test,vtk,lint]"
	touch $(VENV)/.installed $@

$(VENV)/.installed-docs: $(VENV)/.installed pyproject.toml
	$(BIN)/python -m pip install --quiet --editable ".[docs]"
	touch $@

$(VENV)/.installed-bench: $(VENV)/.installed pyproject.toml
	$(BIN)/python -m pip install --quiet --editable ".[bench]"
	touch $@

$(VENV)-memcheck/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)-memcheck
	$(VENV)-memcheck/bin/python -m pip install --quiet --editable ".[memcheck]"
	touch $@

$(VENV)-gpucheck/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)-gpucheck
	$(VENV)-gpucheck/bin/python -m pip install --quiet --editable ".[gpucheck]"
	touch $@

$(VENV)-intel/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)-intel
	$(VENV)-intel/bin/python -m pip install --quiet --editable ".[test,intel]"
	touch $@

$(VENV)-lowest/.installed: pyproject.toml $(VENV)/.installed-dev
	$(PYTHON) -m venv $(VENV)-lowest
	$(BIN)/uv pip install --quiet --python $(VENV)-lowest/bin/python --resolution lowest-direct --editable ".[test]" "click==8.4.*" "pyparsing==3.1.*"
	touch $@

clean:
	rm -rf $(VENV) $(VENV)-intel $(VENV)-memcheck $(VENV)-gpucheck $(VENV)-lowest demo demo-full fuzz-faults dist build .pytest_cache .mypy_cache .ruff_cache .hypothesis
	rm -rf docs/tutorials
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
