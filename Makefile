# make demo    run the ground-vehicle mission, with a picture, a film and logs under out/
# make test    run the tests
# make lint    style, format and types
#
# Everything is installed into a virtual environment of its own on first use. PYTHON names another interpreter.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check
DEMO := out/ground_vehicles

.PHONY: demo test lint clean

demo: $(VENV)/sim.installed
	$(BIN)/fame run examples/ground_vehicles.yaml --picture $(DEMO).png --animate $(DEMO).gif \
		--log $(DEMO).jsonl --log $(DEMO).xes
	@ls $(DEMO).*

test: $(VENV)/dev.installed
	$(BIN)/python -m pytest

lint: $(VENV)/dev.installed
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy --strict fame robots sim2d

clean:
	rm -rf $(VENV) out dist

$(VENV)/%.installed: pyproject.toml | $(BIN)/python
	$(PIP) install --editable '.[$*]'
	@touch $@

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)
