# Thin: every target is a line or two of real commands.
PYTHON ?= python3
JOBS ?= 2
BIN := .venv/bin

.PHONY: setup demo test test-slow lint clean

setup: .venv/installed

.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[build,dev]'
	touch $@

demo: setup
	$(BIN)/objectfolder build -j $(JOBS)

test: setup
	$(BIN)/pytest -n $(JOBS) --dist loadscope

test-slow: setup
	$(BIN)/pytest -m slow

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

clean:
	rm -rf build metrics data/objects/*/
