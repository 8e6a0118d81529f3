# Thin: every target is a line or two of real commands.
PYTHON ?= python3
JOBS ?= 2
# Such as an index with CPU builds of torch; the default index has CUDA builds, gigabytes that nothing here needs.
PIP_ARGS ?=
BIN := .venv/bin

.PHONY: setup demo test test-slow test-extras fuzz lint docs gltf-validate clean

setup: .venv/installed

.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt $(PIP_ARGS) -e '.[build,dev]'
	touch $@

demo: setup
	$(BIN)/objectfolder build -j $(JOBS)

# A test that hangs is killed after ten minutes and says where it was; a process that dies ends the run, as
# pytest-xdist would else wait for tests that it had lost.
test: setup
	$(BIN)/pytest -n $(JOBS) --dist loadscope --no-loadscope-reorder --max-worker-restart 0 \
	  -o faulthandler_timeout=600 -o faulthandler_exit_on_timeout=true

test-slow: setup
	$(BIN)/pytest -m slow

# Optional extras, in environments of their own; prints a table for docs/development.md.
test-extras: setup
	@PIP_ARGS="$(PIP_ARGS)" $(BIN)/python tests/extras/run.py

# Ten minutes each.
fuzz: setup
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt atheris
	$(BIN)/python fuzz/objectfile.py -max_total_time=600
	$(BIN)/python fuzz/queryfiles.py -max_total_time=600
	$(BIN)/python fuzz/released.py -max_total_time=600
	$(BIN)/pytest --hypothesis-profile=fuzz tests/objectfile/test_hostile_files.py

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The site: build/site/index.html. Warnings are errors.
docs: setup
	$(BIN)/sphinx-build --fresh-env --write-all --fail-on-warning --keep-going --quiet docs build/site

# Needs node and npm.
gltf-validate: setup
	npm install --silent --no-save --prefix build/.npm gltf-validator@2.0.0-dev.3.10
	$(BIN)/pytest -n $(JOBS) tests/mesh/reading/test_gltf_validator.py

clean:
	rm -rf build metrics
