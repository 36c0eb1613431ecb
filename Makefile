# make figures   install what runs need and draw the paper's figures into results/figures
# make quick     the tests that are not slow: the main path of each module, in 40 s on two cores
# make test      install what tests need and run them all
# make lint      ruff, the types, the layers
# make check     make lint and make test
# make docs      the documentation as HTML in docs/_build/html
# make docs-images  the pictures in docs/images, with a summary of their data
# make attack    a hundred times as many wrong configs and foreign series, others at every run: an hour
# make claims    decide the paper's claims: a quarter of a minute
# make bench     speed against error, ours and other people's integrators: the table and the figure
# make bench-steps  what single steps, start-up, storage, ensembles and sweeps cost (ratios against named baselines)
# make clean     remove what was built; results/ stays

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
NUMBA_CACHE_DIR ?= $(CURDIR)/$(VENV)/cache
export NUMBA_CACHE_DIR
# pytest rewrites each test module at every start where this is set, as in many containers: ten seconds a process
unexport PYTHONDONTWRITEBYTECODE

.PHONY: venv figures quick test lint check attack docs docs-images claims bench bench-steps clean

venv: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml constraints.txt install.sh
	@PYTHON="$(PYTHON)" sh install.sh $(VENV) .
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	@PYTHON="$(PYTHON)" sh install.sh $(VENV) '.[dev]'
	@touch $@

figures: $(VENV)/.installed
	@$(BIN)/topcli plot --all

quick: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n auto --dist worksteal -m "not slow"

test: $(VENV)/.installed-dev
	@$(BIN)/python -m pytest -n auto --dist worksteal || \
		{ echo "what failed, once more and alone:"; $(BIN)/python -m pytest --last-failed; exit 1; }

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright
	PYTHONPATH=src $(BIN)/lint-imports

check: lint
	@$(MAKE) --no-print-directory test

$(VENV)/.installed-docs: $(VENV)/.installed
	@PYTHON="$(PYTHON)" sh install.sh $(VENV) '.[docs]'
	@touch $@

# the gallery shows the figures
docs: $(VENV)/.installed-docs figures
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs docs/_build/html

docs-images: $(VENV)/.installed
	$(BIN)/python docs/draw_images.py $(ARGS)

claims: $(VENV)/.installed
	@$(BIN)/topcli claims

attack: $(VENV)/.installed-dev
	HYPOTHESIS_PROFILE=attack $(BIN)/python -m pytest -n auto tests/fuzz tests/config/test_config.py

# a peer that cannot be installed is left out: the bench names it
$(VENV)/.installed-peers: $(VENV)/.installed-dev
	@for peer in heyoka diffrax; do \
		PYTHON="$(PYTHON)" sh install.sh $(VENV) ".[$$peer]" >$(VENV)/install-$$peer.log 2>&1 || \
			echo "$$peer could not be installed (see $(VENV)/install-$$peer.log); topcli bench runs without it" >&2; \
	done
	@touch $@

bench: $(VENV)/.installed-peers
	@mkdir -p results/bench
	$(BIN)/topcli bench --config kowalevski_generic_hk --set T=1000 --save results/bench/1.json --force
	$(BIN)/topcli bench --config kowalevski_hk --set T=50 --save results/bench/2.json --force
	$(BIN)/topcli bench --config euler_hk --set T=100 --save results/bench/3.json --force
	$(BIN)/topcli bench --config lagrange_hk --set T=100 --save results/bench/4.json --force
	$(BIN)/topcli plot work-precision

bench-steps: $(VENV)/.installed-dev
	$(BIN)/python benchmarks/steps.py
	$(BIN)/python benchmarks/startup.py
	$(BIN)/python benchmarks/store.py
	$(BIN)/python benchmarks/long_runs.py
	$(BIN)/python benchmarks/ensemble.py
	$(BIN)/python benchmarks/sweeps.py

clean:
	rm -rf $(VENV) .pytest_cache .ruff_cache .hypothesis .import_linter_cache build dist
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
