# Two commands: `make cut` simulates the example, `make test` checks everything. `make notebooks` makes them again.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check

# what a hundred processes import is compiled to bytecode once
unexport PYTHONDONTWRITEBYTECODE

.PHONY: cut test compiled lint type fast notebooks clean

cut: $(VENV)/.installed
	$(BIN)/edmsim cut examples/punch.ngc --out out/punch

test: $(VENV)/.installed-test
	$(MAKE) --jobs 2 compiled lint type docs $(VENV)/.imported
	$(BIN)/python -m pytest -n 2 --dist worksteal

fast: $(VENV)/.installed-test  ## the usual run while developing
	$(BIN)/python -m pytest -m "not slow" -n 2 --dist worksteal

.PHONY: bounds
bounds: $(VENV)/.installed-test  ## where compiled code would leave an array, a test fails; in a cache of its own
	NUMBA_BOUNDSCHECK=1 $(BIN)/python -m pytest -m "not slow" tests/plant tests/axes tests/axis_bench tests/controllers/axis

.PHONY: campaign soak lost-node
campaign: $(VENV)/.installed-test  ## a million bad inputs for every reader together; figures into out/campaign
	$(BIN)/python -m tests.campaigns --inputs 1000000 --out out/campaign

soak: $(VENV)/.installed-test  ## an hour of a machine, a million steps, a hundred kills; figures into out/soak
	$(BIN)/python -m tests.soak --out out/soak

lost-node: $(VENV)/.installed-test  ## a sweep of 200 cuts that loses a node, and whose driver is killed; into out/soak
	$(BIN)/python -m tests.soak sweep --out out/soak

.PHONY: mutants
mutants: $(VENV)/.installed-test  ## do the tests notice sixty small wrongs? results into out/mutants; hours
	$(BIN)/python -m tests.mutants --out out/mutants

compiled: $(VENV)/.installed-test  ## so that no test waits for the compiler
	$(BIN)/edmsim warm-up

# both workers of the tests import the same hundred libraries, and each would make their bytecode, once after they are
# installed; what fails here the tests report
$(VENV)/.imported: $(VENV)/.installed-test
	@$(BIN)/python -m pytest --collect-only -qq > /dev/null || true
	@touch $@

lint: $(VENV)/.installed-test
	$(BIN)/ruff check .

notebooks: $(VENV)/.installed-test  ## executes all of them with their full settings
	$(BIN)/python notebooks/execute.py

type: $(VENV)/.installed-test
	$(BIN)/mypy -p edmsim

.PHONY: docs
docs: $(VENV)/.installed-test  ## the site, into out/docs; docs is a folder, too
	$(BIN)/python -m sphinx -b html -a -d out/doctrees -n -W --keep-going -q docs out/docs

.PHONY: pictures
pictures: cut docs  ## what a newcomer sees, into out/pictures, to be looked at; needs a Chromium
	$(BIN)/python docs/pictures.py

$(VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(PIP) install --quiet --constraint constraints.txt --editable .
	touch $@

# all at once, and each module is compiled when it is imported first: most of what the extras bring never is
$(VENV)/.installed-test: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(PIP) install --quiet --no-compile --constraint constraints.txt --editable ".[test]"
	touch $(VENV)/.installed $@

clean:
	rm -rf $(VENV) build out docs/notebooks *.egg-info .mypy_cache .ruff_cache .pytest_cache
