# Each target creates what it needs in .venv: either is the only command that
# a fresh machine has to run.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Tests see the font list of their own matplotlib, not the one a home holds.
# Asserts that pytest rewrites are kept beside the tests.
TEST_ENV := PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 \
    MPLCONFIGDIR="$(CURDIR)/$(VENV)/matplotlib"

.PHONY: opensim demo test quick docs coverage mutants lint clean

$(VENV)/installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable '.[test]'
	$(TEST_ENV) $(BIN)/python -c "import matplotlib.font_manager"
	touch $@

# OpenSim and xacro in an environment of their own, for tests that ask them.
opensim:
	$(PYTHON) -m venv .opensim
	.opensim/bin/python -m pip install --quiet opensim xacro

demo: $(VENV)/installed
	$(BIN)/drake-exo demo --out demo_results --force

test: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(TEST_ENV) $(BIN)/python -m pytest -n 2 --dist worksteal

quick: $(VENV)/installed
	$(TEST_ENV) $(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow"

docs: $(VENV)/installed
	$(BIN)/python docs/make_api.py docs/api

coverage: $(VENV)/installed
	$(TEST_ENV) $(BIN)/python -m pytest -n 2 --dist worksteal \
	    --cov=drake_exo --cov-branch --cov-report=term-missing:skip-covered

# Errors planted one at a time: those of a list, then some that nobody chose.
mutants: $(VENV)/installed
	$(TEST_ENV) $(BIN)/python tests/mutants.py
	$(TEST_ENV) $(BIN)/python tests/mutants.py --drawn 30 --seed 1

lint: $(VENV)/installed
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf $(VENV) demo_results docs/api
