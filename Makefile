# make demo: set everything up, run the main job on a shipped drive and shape phase currents of two others; make test: set everything up and run the tests.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEMO_DESIGN ?= paper000-ipmsm-100kw

# Modules are compiled once, when they are installed and when they change, not by each process.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo demo-run demo-currents demo-salient-currents test importers campaign faults forged drawn-campaign coverage costs kept times drawn-times check lint types contracts format figures fuzz fuzz-commands mutants sessions numbers docs page-checks page-drives wheel sbom schemas site-checks lock clean

demo: $(VENV)/runtime.stamp
	@mkdir -p out
	@echo "a whole run of $(DEMO_DESIGN), and the phase currents of two machines beside it: solving and drawing take some 4 s on a quiet machine"
	@$(MAKE) --no-print-directory -j demo-run demo-currents demo-salient-currents

# Only the run tells how far it is; the others say something where they fail.
demo-run:
	$(BIN)/dqforge run $(DEMO_DESIGN) -o out/demo

demo-currents:
	$(call currents,paper002-phase-waveforms,phase-currents)

demo-salient-currents:
	$(call currents,salient-phase-waveforms,salient-phase-currents)

currents = $(BIN)/dqforge dqy $(1) --plot out/$(2).svg >out/$(2).txt 2>&1 || { cat out/$(2).txt; exit 1; }

# One thread per worker: the matrices are small, and threads of the linear algebra get in each other's way.
PYTEST := OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist worksteal
DEFAULT := -m "not slow and not benchmark"

# The cheap files and the rules of the house, and of the costly files what fills this many seconds: those near a change,
# then drawn for each commit.
DRAWN_TESTS ?= 80
test: $(VENV)/dev.stamp
	$(PYTEST) $(DEFAULT) --drawn $(DRAWN_TESTS)

# Importers of other firmware, which the tests of its files try them with where they are installed. Without
# dependencies: those that they need stand in the lock.
importers: $(VENV)/importers.stamp

# Long sweeps, searches over many machines, benchmarks: all of them, and what CI draws of them.
campaign: $(VENV)/dev.stamp
	$(PYTEST) -m "slow or benchmark"

DRAWN_CAMPAIGN ?= 300
drawn-campaign: $(VENV)/dev.stamp
	$(PYTEST) -m "slow or benchmark" --drawn $(DRAWN_CAMPAIGN)

# Default tests, and what they run of the proofs: every line; of the branches the last per cent are loops that a
# return leaves. Lines are counted in the proofs alone, which costs little. COVERED="--drawn 300" draws the others.
PROOFS := $(addprefix tests/optimizer/,certificates field_weakening fixed_control observers/methods/test_lpv_certificate.py)
COVERED ?=
coverage: $(VENV)/dev.stamp
	$(PYTEST) $(DEFAULT) $(COVERED) --always $(PROOFS) --cov --cov-report=
	$(BIN)/coverage report --fail-under=99

# Emitted texts, and what functions of physics return, as they were when last accepted: all cases.
kept: $(VENV)/dev.stamp
	$(PYTEST) tests/test_kept_output.py

# What the costly files of tests take, for the draw; on a quiet machine.
costs: $(VENV)/dev.stamp
	$(PYTEST) --keep-costs $(DEFAULT)

# Inputs that no one would write, for every reader, guided by coverage; what is not answered is kept in tests/corpus.
MINUTES ?= 10
fuzz: $(VENV)/fuzz.stamp
	$(BIN)/python tests/fuzz.py --minutes $(MINUTES)

# Command lines that no one would write: every command and option of the parser with hostile values.
fuzz-commands: $(VENV)/dev.stamp
	$(BIN)/python tests/command_lines.py --minutes $(MINUTES)

# Commands that are killed, starved and met by others while they write, and folders that are forged with care: so many,
# drawn by the commit. What fails is kept in tests/corpus, a line each.
FAULTS ?= 1000
faults: $(VENV)/dev.stamp
	$(BIN)/python tests/faults.py $(FAULTS)

FORGED ?= 1000
forged: $(VENV)/dev.stamp
	$(BIN)/python tests/forged_folders.py $(FORGED)

# How many planted changes the nearest tests notice, drawn by the commit.
MUTANTS ?= 30
mutants: $(VENV)/dev.stamp
	$(BIN)/python tests/mutants.py $(MUTANTS)

# What commands take as multiples of a loop, beside the multiples kept in the tree; a slower one is a remark, no failure.
# TIMES=--keep writes them anew, on a quiet machine.
times: $(VENV)/dev.stamp
	$(BIN)/python tests/benchmarks/command_times.py $(TIMES)

drawn-times: $(VENV)/dev.stamp
	$(BIN)/python tests/benchmarks/command_times.py --drawn 12

check: lint types contracts

lint: $(VENV)/dev.stamp
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

types: $(VENV)/dev.stamp
	$(BIN)/mypy -n 2

contracts: $(VENV)/dev.stamp
	$(BIN)/lint-imports

format: $(VENV)/dev.stamp
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

figures: $(VENV)/dev.stamp
	$(BIN)/python docs/drawing/make_figures.py

# What the pages whose sessions are run say that comes, and the figures that they draw; read what it wrote.
sessions: $(VENV)/dev.stamp
	$(BIN)/python tests/documented_sessions.py --update docs/tutorials/*.md docs/how-to/*.md

# Tables of pages that are made of what export emits; read what it wrote.
numbers: $(VENV)/dev.stamp
	$(BIN)/python tests/page_numbers.py

# Generated copies in the package, for editors; a test holds them against the models.
schemas: $(VENV)/dev.stamp
	$(BIN)/dqforge schema -o machines/library/schemas/design.schema.json
	$(BIN)/dqforge schema --study -o machines/library/schemas/study.schema.json

# The site of the documentation, in out/docs; a warning is an error.
docs: $(VENV)/dev.stamp
	rm -rf out/docs
	$(BIN)/sphinx-build -b html -E -W --keep-going -n -q -d out/doctrees docs out/docs

# Links of the site, and the spelling of the site and of a report; needs aspell with British English.
site-checks: docs
	$(BIN)/python tests/site_links.py -f docs/linkchecker.ini out/docs/index.html
	$(BIN)/dqforge run $(DEMO_DESIGN) -o out/demo --no-verify
	PYTHONPATH=docs/extensions $(BIN)/pyspelling -c docs/spelling.yaml

# Accessibility, HTML, links into folded parts, print and size of the reports of these drives and of a study, and of pages
# of the site, where there is one (make docs). Needs node, npm, java and chromium; see docs/reference/report.md.
PAGE_DRIVES := paper000-ipmsm-100kw paper001-pmsm-bench paper002-phase-waveforms salient-phase-waveforms baldor-pmsyrm-5k6 examples/six-step-drive.yaml
page-drives:
	@echo $(PAGE_DRIVES)

page-checks: $(VENV)/runtime.stamp .ci/pages/node_modules
	@PATH="$(CURDIR)/$(BIN):$$PATH" bash .ci/pages/check-pages $(PAGE_DRIVES)

.ci/pages/node_modules: .ci/pages/package-lock.json
	cd .ci/pages && npm ci --ignore-scripts --no-audit --no-fund
	@touch $@

# Wheel and source archive, the same bytes from the same files.
wheel: $(VENV)/dev.stamp
	$(BIN)/python release/build_distributions.py

# What a locked installation consists of, beside the wheel.
sbom: $(VENV)/dev.stamp
	$(BIN)/python release/bill_of_materials.py

# Needs uv; the locks hold the hashes of every file that may be installed.
lock:
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-header --no-annotate -q \
	    pyproject.toml --extra build -o requirements.lock
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-header --no-annotate -q \
	    pyproject.toml --extra build --extra test --extra docs --extra cc --extra dev -o requirements-dev.lock
	uv pip compile --no-deps --generate-hashes --no-header --no-annotate -q \
	    requirements-importers.in -o requirements-importers.lock

clean:
	rm -rf $(VENV) build dist out *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache

# Debian and Ubuntu keep Python's venv module in a package of its own; root gets it installed, others are told its name.
$(BIN)/pip:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	    { echo "dqforge needs Python 3.11 or newer; if you have one, say e.g.: make PYTHON=python3.12 demo" >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV) >/dev/null 2>&1 || { \
	    rm -rf $(VENV); \
	    package=$$($(PYTHON) -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])'); \
	    if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	        apt-get update -q && apt-get install -y -q --no-install-recommends $$package && $(PYTHON) -m venv $(VENV); \
	    else \
	        echo "Python's venv module is missing; install it with: sudo apt-get install $$package" >&2; exit 1; \
	    fi; }

# The locks are whole: nothing is to be resolved, and a newer release of a package can't turn an extra of it into one without a hash.
$(VENV)/runtime.stamp: requirements.lock pyproject.toml | $(BIN)/pip
	@echo "installing the locked packages into $(VENV): once, for a minute or two"
	$(BIN)/pip install -q --disable-pip-version-check --no-deps --require-hashes -r requirements.lock
	$(BIN)/pip install -q --disable-pip-version-check --no-deps --no-build-isolation -e .
	$(BIN)/python -m compileall -q -j 0 __init__.py cli.py machines optimizer reports
	@touch $@

$(VENV)/dev.stamp: requirements-dev.lock $(VENV)/runtime.stamp
	$(BIN)/pip install -q --disable-pip-version-check --no-deps --require-hashes -r requirements-dev.lock
	@touch $@

$(VENV)/fuzz.stamp: requirements-fuzz.lock $(VENV)/dev.stamp
	$(BIN)/pip install -q --disable-pip-version-check --no-deps --require-hashes -r requirements-fuzz.lock
	@touch $@

$(VENV)/importers.stamp: requirements-importers.lock $(VENV)/dev.stamp
	$(BIN)/pip install -q --disable-pip-version-check --no-deps --no-build-isolation --require-hashes -r requirements-importers.lock
	@touch $@
