# make install | demo | test | test-app | lint | types | gate | coverage | notebooks | paper | docs | docs-links | docs-test | bench-NAME    each does its own set-up; doing it twice costs nothing.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/ready
DOCS_READY := .venv/ready-docs
BROWSER_READY := .venv/ready-browser
# tests start hundreds of processes: each would compile every module again
export PYTHONDONTWRITEBYTECODE :=

.PHONY: install demo test test-app lint types gate coverage notebooks paper docs docs-links docs-test clean

install: $(READY)

$(READY): requirements.lock pyproject.toml tools/setup.sh
	@sh tools/setup.sh $(PYTHON)
	@touch $@

demo: $(READY)
	@$(BIN)/python -m benchmarks.demo

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(READY)
	$(BIN)/mypy

test: lint types
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadfile

$(BROWSER_READY): requirements-browser.lock $(READY)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-browser.lock
	@touch $@

# the workbench in a headless Chromium, which has to be installed
test-app: $(BROWSER_READY)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -rs tests/in_browser/workbench.py

# tests of whole searches and of large samples, then tracking errors beside accepted figures
gate: $(READY)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadfile -m gate $$(grep -rl "mark\.gate\|each_outsider" --include="test_*.py" tests)
	$(BIN)/python -m benchmarks.regression.gate

coverage: $(READY)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadfile --cov --cov-report=term:skip-covered --cov-report=html:out/coverage

# long studies: python -m benchmarks.FOLDER.NAME, results in out/
bench-%: $(READY)
	$(BIN)/python -m $(subst /,.,$(basename $(wildcard benchmarks/*/$(subst -,_,$*).py)))

# run the notebooks of examples/ and store their outputs
notebooks: $(READY)
	$(BIN)/python tools/notebooks.py

# the paper's experiment from rendered video: every figure and number of it, out/paper/index.html and paper.pdf
paper: $(READY)
	$(BIN)/python -m benchmarks.paper.make

$(DOCS_READY): requirements-docs.lock $(READY)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-docs.lock
	@touch $@

# the site: each warning is an error, so are links that lead nowhere; no network is needed
docs: $(DOCS_READY)
	@$(BIN)/python -m sphinx --fail-on-warning --keep-going --fresh-env --quiet --doctree-dir out/docs/doctrees docs out/docs/html
	@echo out/docs/html/index.html

# links to other places; without a network it cannot be run
docs-links: $(DOCS_READY)
	$(BIN)/python -m sphinx --builder linkcheck --quiet --doctree-dir out/docs/doctrees docs out/docs/links

# every block of code of the docs, as it stands
docs-test: $(READY)
	OMP_NUM_THREADS=1 $(BIN)/python tools/doc_blocks.py

clean:
	rm -rf .venv demo docs/generated
