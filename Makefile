# `make demo` and `make test` do everything on a fresh machine; `make help` lists all targets.

PYTHON ?= python3
BIN := .venv/bin

.DEFAULT_GOAL := demo
.PHONY: help demo setup test check slow clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  make %-7s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: .venv/.installed ## record five floor plans with and without prediction, and compare them
	$(BIN)/python samples/demo.py

setup: .venv/.installed-dev ## create .venv with the package and the development tools

test: .venv/.installed-dev check ## lint, types and tests with coverage (about six minutes on two cores)
	$(BIN)/pytest --numprocesses auto --dist loadfile --cov --cov-report=term:skip-covered

check: .venv/.installed-dev ## only lint, format and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy -p mapreplay

slow: .venv/.installed-dev ## the tests that take minutes: killed recordings, every bit of a log flipped
	$(BIN)/pytest -m slow

clean: ## remove .venv, builds and recorded runs
	rm -rf .venv build runs *.egg-info

.venv/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --constraint constraints.txt setuptools
	$(BIN)/pip install --quiet --constraint constraints.txt --no-build-isolation --editable .
	touch $@

.venv/.installed-dev: .venv/.installed
	$(BIN)/pip install --quiet --constraint constraints.txt --no-build-isolation --editable '.[dev]'
	touch $@
