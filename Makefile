# A fresh machine needs Python >= 3.11, make and a C compiler; everything else is installed here,
# into .venv, in the versions of requirements.lock.

PYTHON ?= python3
BIN := .venv/bin
SOURCES := $(shell find congelation fmu_src specs -name '*.py' -o -name '*.toml' -o -name '*.html' -o -name '*.txt' -o -name '*.png' -o -name '*.[ch]') build_fmu.py

.PHONY: help demo test system-packages system-packages-further test-platforms test-fast fuzz check format bench bench-coupling corpus docs fmus lock clean

help:
	@echo "make demo    Figs. 1-3 of the paper from FMUs, a sweep, and a page that links them all"
	@echo "make test    the whole test suite"
	@echo "make system-packages   what tests use that is no Python package (Debian, as root)"
	@echo "make system-packages-further   the same for test-platforms and fuzz"
	@echo "make test-platforms   native FMUs for Windows and ARM, run in emulators; installs ziglang and, as root, wine64 and qemu-user"
	@echo "make test-fast   the tests that are not marked slow"
	@echo "make fuzz    the property-based tests marked fuzz, with 1,000 fresh examples each, ten minutes each of mutations and of calls of native FMUs (random, by libFuzzer), every rule on every FMU, test-platforms"
	@echo "make check   format, lint, types, import layers"
	@echo "make bench   benchmarks; the table goes to docs/benchmarks.md"
	@echo "make bench-coupling   error bars, work and precision on problems with known solutions"
	@echo "make corpus  check the public FMUs in the folder CORPUS=.. (docs/conformance.md)"
	@echo "make docs    the documentation as a site, in build/docs"
	@echo "make fmus    build the FMUs into fmus/"
	@echo "make format  put the sources into the format that make check asks for"
	@echo "make lock    resolve the dependencies anew into requirements*.lock"
	@echo "make clean   remove what was generated"

.venv/installed: pyproject.toml requirements.lock setup.py $(wildcard congelation/cosim/loop/*.[ch])
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python >= 3.11 is needed; set PYTHON=..")'
	$(PYTHON) -m venv .venv
	@echo "installing into .venv, which takes some minutes"
	$(BIN)/pip install --quiet --disable-pip-version-check --requirement requirements.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --editable .
	@touch $@

# CoFmuPy, one of the engines that the tests run, pins other versions of FMPy and PythonFMU.
.venv-cofmupy/installed: requirements-cofmupy.lock
	$(PYTHON) -m venv .venv-cofmupy
	.venv-cofmupy/bin/pip install --quiet --disable-pip-version-check --requirement requirements-cofmupy.lock
	@touch $@

fmus/manifest.json: .venv/installed $(SOURCES)
	$(BIN)/python build_fmu.py

fmus/native/manifest.json: .venv/installed $(SOURCES)
	$(BIN)/python build_fmu.py --native

fmus: fmus/manifest.json fmus/native/manifest.json

DEMO := scalar fig1 fig2 fig3 fig3_r11 strike

demo: fmus
	@for name in $(DEMO); do \
		$(BIN)/congelation run scenarios/$$name.toml --workers 2 --out results/$$name || exit $$?; \
		$(BIN)/congelation report results/$$name || exit $$?; \
	done
	@$(BIN)/congelation sweep scenarios/rivals.toml --workers 2 --resume --out results/rivals
	@$(BIN)/congelation report results/rivals
	@$(BIN)/python -m congelation.report.index results

# More processes than cores, as tests that wait for processes leave them idle; the slow files first.
PYTEST = $(BIN)/python -m pytest -n $(1) --dist loadfile --no-loadscope-reorder

# Debian's packages that tests use; a test that lacks one is skipped, and says so.
SYSTEM_PACKAGES := chromium cppcheck
# What test-platforms and fuzz use besides: 300 MB, a minute.
FURTHER_PACKAGES := wine64 qemu-user libc6-arm64-cross valgrind clang-14 libclang-rt-14-dev

system-packages:
	@for name in $(SYSTEM_PACKAGES); do \
		dpkg-query --show --showformat='$${Status}' $$name 2>/dev/null | grep -q "ok installed" || missing="$$missing $$name"; \
	done; test -z "$$missing" || { apt-get update --quiet && apt-get install --yes --no-install-recommends $$missing; }

system-packages-further:
	@$(MAKE) --no-print-directory system-packages SYSTEM_PACKAGES="$(FURTHER_PACKAGES)"

FURTHER := if test "$$(id -u)" = 0 && command -v apt-get >/dev/null; then $(MAKE) --no-print-directory system-packages-further; fi

# ziglang compiles the libraries of each platform at first: a minute and a half of processor time for
# Windows, a few seconds for each other one. They stay in its cache (ZIG_GLOBAL_CACHE_DIR).
test-platforms: fmus
	$(BIN)/pip install --quiet --disable-pip-version-check --requirement requirements-platforms.lock
	-@$(FURTHER)
	$(BIN)/python -m pytest tests/native/test_platforms.py

# Where the system's packages can be had, they are installed; else the tests say what they skipped.
test: fmus .venv-cofmupy/installed
	-@if test "$$(id -u)" = 0 && command -v apt-get >/dev/null; then $(MAKE) --no-print-directory system-packages; fi
	$(call PYTEST,4)

# These wait for nothing, and each process has to collect them all.
test-fast: fmus
	$(call PYTEST,2) -m "not slow"

SECONDS_OF_MUTATIONS = 600
fuzz: fmus
	-@$(FURTHER)
	CONGELATION_FUZZ_SECONDS=$(SECONDS_OF_MUTATIONS) $(BIN)/python -m pytest -m fuzz --hypothesis-profile=fuzz
	$(BIN)/congelation check fmus/*.fmu fmus/native/*.fmu
	$(MAKE) --no-print-directory test-platforms

check: .venv/installed
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: .venv/installed
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# Error bars are counted; work and precision is timed: on a machine with nothing else to do.
bench-coupling: fmus
	$(BIN)/python -m benchmarks.coupling

bench: fmus .venv-cofmupy/installed
	$(BIN)/python -m benchmarks
	$(BIN)/python -m benchmarks.peers

# The FMUs are fetched and built by the person who runs this; none of them is in the repository.
corpus: .venv/installed
	@test -d "$(CORPUS)" || { echo "CORPUS=.. names a folder with FMUs; docs/conformance.md says where they are from"; exit 2; }
	@mkdir -p build/corpus
	@find "$(CORPUS)" -name '*.fmu' | sort | while read -r fmu; do \
		name=$$(basename "$$fmu" .fmu); \
		$(BIN)/congelation check "$$fmu" --time-limit 15 --json "build/corpus/$$name.json" </dev/null \
			| sed "s#^$(CORPUS)/##" | tee "build/corpus/$$name.txt"; \
	done

# Runs the code cells of the tutorials, too. A warning is an error.
docs: fmus
	$(BIN)/sphinx-build --quiet --fail-on-warning --fresh-env --builder html docs build/docs
	@echo build/docs/index.html

# ziglang has a lock of its own: 400 MB that one target alone needs.
EXTRAS := cluster control dev docs lmi pandas
lock:
	$(PYTHON) -m venv build/lock
	build/lock/bin/pip install --quiet uv
	build/lock/bin/uv pip compile --quiet --universal --python-version 3.11 \
		$(EXTRAS:%=--extra %) --no-emit-index-url --no-header --output-file requirements.lock pyproject.toml
	echo cofmupy==1.0.0 | build/lock/bin/uv pip compile --quiet --universal --python-version 3.11 \
		--no-emit-index-url --no-header --output-file requirements-cofmupy.lock -
	echo ziglang | build/lock/bin/uv pip compile --quiet --universal --python-version 3.11 \
		--no-emit-index-url --no-header --output-file requirements-platforms.lock -

clean:
	rm -rf .venv .venv-cofmupy build results fmus/*.fmu fmus/manifest.json fmus/native .mypy_cache .ruff_cache .pytest_cache
