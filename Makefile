# `make demo` and `make test` are all that is needed on a fresh machine. uv is used if it is there, pip if not.

VENV := .venv
PYTHON ?= python3
BIN := $(VENV)/bin
ARGS ?=

.PHONY: demo test test-all lint docs gallery clean

demo: $(VENV)/.run
	$(BIN)/roboassembly assemble --manual --film-size 854x480 $(ARGS)

test: $(VENV)/.dev
	$(BIN)/pytest -n 2 --dist worksteal $(ARGS)

test-all: $(VENV)/.dev $(VENV)/.rl $(VENV)/.browser
	$(BIN)/pytest -n 2 -m "slow or not slow" -o faulthandler_timeout=7200 $(ARGS)

lint: $(VENV)/.dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright
	$(BIN)/lint-imports
	$(BIN)/python tools/check_names.py

# Not --quiet: MkDocs would then count no warnings, and --strict would have nothing to go by.
docs: $(VENV)/.dev
	$(BIN)/python tools/site.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

gallery: $(VENV)/.dev
	$(BIN)/python tools/gallery.py

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "RoboAssembly needs Python 3.11 or newer; name one with: make PYTHON=python3.12 ..." >&2; exit 1; }
	@if command -v uv >/dev/null; then uv venv --quiet --seed --python $(PYTHON) $(VENV); \
		else $(PYTHON) -m venv $(VENV) && $(BIN)/python -m pip install --quiet --upgrade pip; fi

# $(call install,WHAT): by uv if it is there, else by pip. No comma in WHAT: make would end it there.
install = if command -v uv >/dev/null; then uv pip install --quiet --python $(BIN)/python $(1); \
	else $(BIN)/python -m pip install --quiet $(1); fi

$(VENV)/.run: pyproject.toml | $(VENV)/bin/python
	@echo "installing into $(VENV) ..." >&2
	@$(call install,--editable .)
	@touch $@

$(VENV)/.dev: pyproject.toml | $(VENV)/bin/python
	@echo "installing into $(VENV) ..." >&2
	@$(call install,--editable . --group dev)
	@touch $@ $(VENV)/.run

# By pip in any case: it takes a CPU build of PyTorch where the machine offers one, which uv does not look for.
$(VENV)/.rl: $(VENV)/.dev
	@$(BIN)/python -m pip install --quiet torch==2.13.0 || $(BIN)/python -m pip install --quiet torch
	@$(call install,--editable '.[rl]' --editable '.[ray]')
	@{ $(call install,--editable '.[franky]'); } || echo "no franky here: its test will be skipped" >&2
	@touch $@

# A Chromium that is there is taken; else the system's package manager or Playwright's own installer is asked for one.
$(VENV)/.browser: $(VENV)/.dev
	@$(call install,playwright)
	@command -v chromium chromium-browser google-chrome >/dev/null || \
		apt-get install -y --no-install-recommends chromium >/dev/null 2>&1 || \
		$(BIN)/playwright install chromium || echo "no Chromium: the studio's tests in a browser will be skipped" >&2
	@touch $@

clean:
	rm -rf $(VENV) build dist assembly .pytest_cache .ruff_cache .hypothesis
