# Two commands: `make demo` shows the tool at work, `make test` proves it. Both do their own set-up.

PYTHON ?= python3
VENV := .venv
ifeq ($(OS),Windows_NT)
BIN := $(VENV)/Scripts
EXE := .exe
else
BIN := $(VENV)/bin
EXE :=
endif
READY_DEMO := $(VENV)/.ready-demo
READY := $(VENV)/.ready-dev
READY_BENCH := $(VENV)/.ready-bench
READY_SITE := $(VENV)/.ready-site
# Exact versions, so that the sample logs and the test results are the same on every machine.
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint .ci/constraints.txt
# As a path, where type checkers find it; by default it would be a hook that only Python knows.
EDITABLE := $(INSTALL) --config-settings editable_mode=compat --editable

.PHONY: demo test thorough bare lowest dist fuzz lint format documents site bench sample-logs clean help

help:
	@echo 'make demo         propagate the sample logs and show how far they are from the truth'
	@echo 'make test         run the tests, some cases of each'
	@echo 'make thorough     run all cases of all tests, and more drawn ones; make fuzz goes on where it ends'
	@echo 'make bare         run the tests without what only POSIX has: fcntl, fork, signals, pipes'
	@echo 'make lowest       run the tests with the lowest versions that pyproject.toml allows'
	@echo 'make dist         build wheel and sdist, and run the tests of the sdist'
	@echo 'make fuzz         random properties, damaged logs, command lines, stores that fail, batches that are killed, regressions, planted mistakes: report what goes wrong'
	@echo 'make lint         ruff, and mypy for Linux, macOS and Windows'
	@echo 'make format       let ruff format the code'
	@echo 'make documents    update the documents: what commands print, tables, pictures, references'
	@echo 'make site         the documents as a site, in .site/; links between its pages are checked'
	@echo 'make bench        measure against rosbags, mcap, pyarrow, polars, h5py, scipy, ahrs, numba and numpy-quaternion'
	@echo 'make sample-logs  generate sample_logs/ again, bit for bit'
	@echo 'make clean        remove everything that was made here'

$(BIN)/python$(EXE):
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo 'quatprop needs Python 3.11 or newer: make PYTHON=/path/to/python3'; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(READY_DEMO): pyproject.toml .ci/constraints.txt | $(BIN)/python$(EXE)
	$(EDITABLE) '.[plot]'
	@touch $@

$(READY): pyproject.toml .ci/constraints.txt | $(BIN)/python$(EXE)
	$(EDITABLE) '.[dev]'
	@touch $@ $(READY_DEMO)

$(READY_BENCH): pyproject.toml .ci/constraints.txt | $(BIN)/python$(EXE)
	$(EDITABLE) '.[dev,bench]'
	@touch $@ $(READY) $(READY_DEMO)

$(READY_SITE): pyproject.toml .ci/constraints.txt | $(BIN)/python$(EXE)
	$(EDITABLE) '.[site]'
	@touch $@

demo: $(READY_DEMO)
	@PATH="$(CURDIR)/$(BIN):$$PATH" sh sample_logs/demo.sh

# Each worker has its part in a row, so that what a module makes for its tests is made once.
test: $(READY)
	$(BIN)/python -m pytest -n auto --dist worksteal

# Every case, also of the tests that are marked thorough, ten times as many odd logs, and 400
# calibrations of each model.
thorough: $(READY)
	ODD_LOGS=10 CALIBRATIONS=400 $(BIN)/python -m pytest -n auto --dist worksteal --thorough

# As near to Windows as other systems come.
bare: $(READY)
	PYTHONPATH=tests $(BIN)/python -m pytest -p make.bare_system -n auto --dist worksteal

lowest:
	$(PYTHON) -m venv --clear .venv-lowest
	.venv-lowest/bin/python -m pip install --quiet --disable-pip-version-check uv
	.venv-lowest/bin/uv pip install --quiet --python .venv-lowest/bin/python --resolution lowest-direct \
		--editable '.[dev]'
	.venv-lowest/bin/python -m pytest -n auto --dist worksteal

dist:
	rm -rf dist build *.egg-info
	$(PYTHON) -m venv --clear .venv-dist
	.venv-dist/bin/python -m pip install --quiet --disable-pip-version-check build
	.venv-dist/bin/python -m build --outdir dist .
	mkdir dist/sdist
	tar -xzf dist/*.tar.gz -C dist/sdist --strip-components 1
	$(MAKE) -C dist/sdist test

fuzz: $(READY)
	$(BIN)/python -m pytest -n auto -q -m hypothesis --hypothesis-profile fuzz
	cd tests && ../$(BIN)/python -m fuzz.damage
	cd tests && ../$(BIN)/python -m fuzz.flips
	cd tests && ../$(BIN)/python -m fuzz.command_lines
	cd tests && ../$(BIN)/python -m fuzz.causes
	cd tests && ../$(BIN)/python -m fuzz.calibrations
	cd tests && ../$(BIN)/python -m fuzz.crosschecks
	cd tests && ../$(BIN)/python -m fuzz.stores
	cd tests && ../$(BIN)/python -m fuzz.fleets
	cd tests && ../$(BIN)/python -m fuzz.regressions
	cd tests && ../$(BIN)/python -m fuzz.remarks

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy --platform linux
	$(BIN)/mypy --platform darwin
	$(BIN)/mypy --platform win32
	$(BIN)/mypy --strict tests/examples/first_week.py

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

documents: $(READY)
	PYTHONPATH=tests $(BIN)/python -m make.documents

site: $(READY_SITE)
	PYTHONPATH=tests NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict -f quatprop/docs/site/mkdocs.yml

bench: $(READY_BENCH)
	PYTHONPATH=tests $(BIN)/python tests/bench

sample-logs: $(READY)
	$(BIN)/python sample_logs/generate.py

clean:
	rm -rf $(VENV) .venv-lowest .venv-dist dist .demo .bench .site build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
