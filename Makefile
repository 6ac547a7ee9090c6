# mooringdx: `make` lists what can be made. Needs make and Python 3.11 or newer; everything else goes into .venv.

.DEFAULT_GOAL := help
MAKEFLAGS += --no-print-directory
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
CODE := mooringdx tests $(wildcard benchmarks)
PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3 python; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1 && { echo $$p; break; }; done)

.PHONY: help demo test check slow bench clean lock data

help: ## list what can be made
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  make %-8s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: $(READY) ## a line parts in a model basin: fit, detect, report
	@$(BIN)/mooringdx run configs/runs/demo.toml -o reports/demo; status=$$?; \
	if [ $$status -ne 3 ]; then \
		echo "error: the demo ended with exit status $$status; 3 (a fault found) was expected" >&2; exit 1; fi; \
	echo "Fault found, as it should be. Open reports/demo/report.html"

test: $(READY) ## the fast tests
	@$(BIN)/python -m pytest -q -n 2

check: $(READY) ## all that continuous integration runs: format, lint, types, layers, fast tests
	@$(BIN)/ruff format --check $(CODE)
	@$(BIN)/ruff check $(CODE)
	@$(BIN)/mypy
	@$(BIN)/lint-imports
	@$(BIN)/python -m pytest -q -n 2

slow: $(READY) ## the Monte Carlo tests
	@$(BIN)/python -m pytest -q -m slow

bench: $(READY) ## what things cost, as ratios against named peers in the same run
	@for script in benchmarks/*.py; do echo "$$script"; $(BIN)/python $$script || exit 1; done

clean: ## remove what make made: .venv, caches, the demo's report
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis reports/demo
	find mooringdx tests benchmarks -name __pycache__ -prune -exec rm -rf {} +

lock: $(READY) ## pin every dependency with its hashes anew (needs uv)
	@command -v uv >/dev/null || { echo "error: \`make lock\` needs uv on the PATH" >&2; exit 1; }
	@{ echo "# Made by \`make lock\` from pyproject.toml, for every platform and Python >= 3.11. Do not edit."; \
	uv pip compile --quiet --universal --python-version 3.11 --extra dev --generate-hashes \
		--no-annotate --no-header --no-emit-index-url pyproject.toml; } > requirements.lock.new
	@mv requirements.lock.new requirements.lock

data: $(READY) ## make the logs in data/ anew; the same bytes every time
	@for log in demo.csv demo.mcap; do \
		$(BIN)/mooringdx simulate configs/scenarios/demo.toml -o data/$$log --seed 1 || exit 1; done
	@cd data && ../$(BIN)/python -c 'import hashlib, pathlib; [print(hashlib.sha256(p.read_bytes()).hexdigest(), "", p) \
		for p in sorted(pathlib.Path(".").glob("demo.*"))]' > SHA256SUMS

$(READY): requirements.lock pyproject.toml
	@test -n "$(PYTHON)" || { \
		echo "error: no Python 3.11 or newer found; install one, or name it: make PYTHON=/path/to/python3.11" >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV) || { \
		echo "error: $(PYTHON) cannot make a virtual environment; on Debian and Ubuntu install python3-venv" >&2; exit 1; }
	@echo "Installing into $(VENV) (once) ..."
	@$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check --require-hashes -r requirements.lock
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@
