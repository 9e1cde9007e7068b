# make install | demo | test | lint | gate | bench-*    each does its own set-up; doing it twice costs nothing.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/ready

.PHONY: install demo test lint types gate bench-accuracy bench-speed clean

install: $(READY)

$(READY): requirements.lock pyproject.toml tools/setup.sh
	@sh tools/setup.sh $(PYTHON)
	@touch $@

demo: $(READY)
	@$(BIN)/python benchmarks/demo.py

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(READY)
	$(BIN)/mypy

test: lint types
	$(BIN)/python -m pytest -n 2

gate: $(READY)
	$(BIN)/python benchmarks/gate.py

bench-accuracy: $(READY)
	$(BIN)/python benchmarks/accuracy.py

bench-speed: $(READY)
	$(BIN)/python benchmarks/speed.py

clean:
	rm -rf .venv demo
