# Two commands set everything up: `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SEED ?= $(shell date +%s)# of the tests that draw their examples; a given one draws them again
export PIP_DISABLE_PIP_VERSION_CHECK = 1

.PHONY: demo test install clean

install: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/pip install --quiet --group dev --editable .
	touch $@

clean:
	rm -rf $(VENV) demo

demo: install
	rm -rf demo && mkdir -p demo
	$(BIN)/mapmyworld build sample_logs/apartment.mcap -o demo/map.db
	$(BIN)/mapmyworld inspect graph demo/map.db --image demo/graph.png > demo/graph.txt
	@echo "The map of sample_logs/apartment.mcap is in demo/: map.pgm + map.yaml (grid), map.ply"
	@echo "(cloud), map.tum (trajectory), map.html (the report: open it), map.db (everything),"
	@echo "graph.png + graph.txt (the graph)."

test: install
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/pytest -n logical --dist loadfile --hypothesis-seed=$(SEED)
