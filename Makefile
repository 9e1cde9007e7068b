# make install | demo | test | lint | types | gate | coverage | notebooks | paper | bench-NAME    each does its own set-up; doing it twice costs nothing.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/ready

.PHONY: install demo test lint types gate coverage notebooks paper clean

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

gate: $(READY)
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

clean:
	rm -rf .venv demo
