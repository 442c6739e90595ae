# On a fresh machine with Python 3.11 to 3.13: `make run`, `make test`.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# Where Linux finds torch without gigabytes of CUDA; asked for torch alone.
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu

.PHONY: run test lint types setup check wheel

run: setup
	$(BIN)/python -m zoac.run task=pid_acc tuner=zoac_plus seed=0

test: setup
	$(BIN)/python -m pytest -n auto --dist loadfile

check: lint types test

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

# mypy finds zoac.tasks and its siblings where an installed copy has them.
types: setup
	rm -rf .cache/types && mkdir -p .cache/types/zoac
	ln -s $(CURDIR)/zoac/* $(CURDIR)/conf $(CURDIR)/tasks $(CURDIR)/baselines $(CURDIR)/analysis .cache/types/zoac/
	cd .cache/types && $(abspath $(BIN))/mypy --config-file $(CURDIR)/pyproject.toml --cache-dir $(CURDIR)/.cache/mypy -p zoac

setup: $(VENV)/.ready

$(VENV)/.ready: pyproject.toml constraints-cpu.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade "pip>=24"
	$(BIN)/python -m pip install --quiet --no-deps --retries 1 --extra-index-url $(TORCH_INDEX) \
		-c constraints-cpu.txt torch
	$(BIN)/python -m pip install --quiet -c constraints-cpu.txt -e ".[dev]"
	touch $@

wheel: setup
	$(BIN)/python -m build --wheel
