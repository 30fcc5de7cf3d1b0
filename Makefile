# make run      set everything up and show the bundled bowl video (Ctrl-C stops it)
# make test     set everything up and run all that must hold
# make test-kernel  set everything up and test against real kernel devices, in a virtual machine where one can be had
# make bench    measure side by side with OpenCV's finders, and cost, growth, specks and the service; prints Markdown
# make test-wheel   install the wheel as a user does and run every command, from another folder
# make faults   a million frames from a device that goes wrong all the time, each accounted for (FRAMES=1000000)
# make soak     the live service for minutes: its memory, files and threads must not grow (MINUTES=3)
# make tamper   a thousand single bytes of a recorded session changed, one at a time: verify must find each
# make figures  how soon frames, failures and stops are served on this machine; best run on an idle one
# make install  the set-up alone

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
PEERS  := $(VENV)/peers

.PHONY: run test test-kernel faults soak tamper figures test-wheel install check pytest bench clean

run: install
	@$(BIN)/bowlsight demo

install: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(0 if v >= (3, 11) else f"Bowlsight needs Python 3.11 or newer; {sys.executable} is {v[0]}.{v[1]}. Try: make PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	@touch $@

test: install check pytest

check: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

pytest: install
	$(BIN)/pytest

test-kernel: install
	$(BIN)/python -m tests.kernel.run

test-wheel: install
	$(BIN)/python -m tests.wheel.run

bench: install $(PEERS)
	@PYTHONPATH=$(PEERS) $(BIN)/python -m tests.bench $(ARGS)

# The extra "bench", beside the environment and not in it: two OpenCVs in one would overwrite each other.
$(PEERS): pyproject.toml constraints.txt
	@$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --upgrade --constraint constraints.txt --target $@ opencv-contrib-python-headless \
	  && touch $@ || echo "opencv-contrib cannot be had: EdgeDrawing is left out"

FRAMES  ?= 1000000
MINUTES ?= 3

faults: install
	$(BIN)/python -m tests.bench.faults $(FRAMES)

soak: install
	$(BIN)/python -m tests.bench.soak $(MINUTES)

tamper: install
	$(BIN)/python -m tests.sinks.session.tamper

figures: install
	$(BIN)/python -m tests.bench.capture
	$(BIN)/python -m tests.bench.load
	$(BIN)/python -m tests.bench.recovery

clean:
	rm -rf $(VENV) dist build .mypy_cache .ruff_cache .pytest_cache
