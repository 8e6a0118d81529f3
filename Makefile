# Thin: every target is a line or two of real commands.
PYTHON ?= python3
JOBS ?= 2
# Such as an index with CPU builds of torch; the default index has CUDA builds, gigabytes that nothing here needs.
PIP_ARGS ?=
BIN := .venv/bin
INSTALL = $(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt $(PIP_ARGS)

.PHONY: setup demo test test-slow test-extras fuzz lint docs viewer samples gltf-validate wheel lock sbom licences clean

# What a build needs. The targets below that test or check install the rest.
setup: .venv/.build

.venv/.build: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(INSTALL) -e '.[build]'
	touch $@

.venv/.dev: .venv/.build
	$(INSTALL) -e '.[dev]'
	touch $@

demo: .venv/.build
	$(BIN)/objectfolder build -j $(JOBS)

# A test that hangs is killed after ten minutes and says where it was; a process that dies ends the run, as
# pytest-xdist would else wait for tests that it had lost.
test: .venv/.dev
	$(BIN)/pytest -n $(JOBS) --dist loadscope --no-loadscope-reorder --max-worker-restart 0 \
	  -o faulthandler_timeout=600 -o faulthandler_exit_on_timeout=true

test-slow: .venv/.dev
	$(BIN)/pytest -m slow

# Optional extras, in environments of their own; prints a table for docs/development.md.
test-extras: .venv/.dev
	@PIP_ARGS="$(PIP_ARGS)" $(BIN)/python tests/extras/run.py

# Ten minutes each; random sequences of edits, faults and builds, and each parameter alone, take an hour.
fuzz: .venv/.dev
	$(INSTALL) atheris
	$(BIN)/python fuzz/objectfile.py -max_total_time=600
	$(BIN)/python fuzz/queryfiles.py -max_total_time=600
	$(BIN)/python fuzz/released.py -max_total_time=600
	$(BIN)/pytest -m slow tests/mesh/reading/test_random_files.py
	$(BIN)/pytest --hypothesis-profile=fuzz tests/objectfile/test_hostile_files.py
	$(BIN)/pytest --hypothesis-profile=fuzz -s tests/engine/test_random_sequences.py \
	  tests/engine/test_every_parameter.py

lint: .venv/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The site: build/site/index.html. Warnings are errors, and so are links and pictures that are missing.
docs: .venv/.dev
	rm -rf build/site
	$(BIN)/sphinx-build --fresh-env --write-all --fail-on-warning --keep-going --quiet docs build/site
	$(BIN)/python docs/links.py build/site

# The Object Files that come with the package.
samples: demo
	for name in mug die bell; do cp build/$$name/ObjectFile.safetensors objectfolder/objectfile/samples/$$name.safetensors; done

# The page that Object Files answer in: rebuilds what the package ships. Needs node and npm, its tests Chromium.
viewer: .venv/.dev
	npm ci --silent --prefix viewer
	cd viewer && npm run --silent check && npm test --silent && npm run --silent build
	$(BIN)/pytest -m "" tests/viewer

# Needs node and npm.
gltf-validate: .venv/.dev
	npm install --silent --no-save --prefix build/.npm gltf-validator@2.0.0-dev.3.10
	$(BIN)/pytest -n $(JOBS) tests/mesh/reading/test_gltf_validator.py

# What PyPI would get: dist/. Installs it with each supported Python that is here.
wheel: .venv-supply/.tools
	.ci/wheel $(PIP_ARGS)

# Hashes of base and build for pip --require-hashes. torch is apart: its CPU build has other hashes.
UV_LOCK = UV_CUSTOM_COMPILE_COMMAND='make lock' .venv-supply/bin/uv pip compile --quiet --no-config --universal \
  --python-version 3.11 --generate-hashes --annotation-style line -c constraints.txt
lock: .venv-supply/.tools
	echo torch | $(UV_LOCK) --extra build --excludes /dev/stdin pyproject.toml -o requirements.lock
	echo torch | $(UV_LOCK) - -o requirements-torch.lock

# What a user of base and build gets: build/sbom.json (CycloneDX), of an environment installed from the lock.
sbom: .venv-supply/.tools .venv-lock/.installed
	mkdir -p build
	.venv-supply/bin/cyclonedx-py environment --output-reproducible --pyproject pyproject.toml -o build/sbom.json \
	  .venv-lock

# docs/licences.csv
licences: .venv/.dev
	$(BIN)/python docs/licences.py

.venv-supply/.tools: Makefile
	$(PYTHON) -m venv .venv-supply
	.venv-supply/bin/pip install --quiet --disable-pip-version-check build==1.6.1 cyclonedx-bom==7.5.0 \
	  twine==7.0.0 uv==0.13.9
	touch $@

.venv-lock/.installed: requirements.lock
	$(PYTHON) -m venv --clear .venv-lock
	.venv-lock/bin/pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	.venv-lock/bin/pip install --quiet --disable-pip-version-check -c constraints.txt $(PIP_ARGS) torch
	.venv-lock/bin/pip check
	touch $@

clean:
	rm -rf build metrics
