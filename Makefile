# Everything runs in .venv, made on first use from constraints.txt. Another interpreter: make PYTHON=python3.12 ...
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV ?= .venv
BIN := $(VENV)/bin
RUN ?= corridor-$(shell date +%Y%m%d-%H%M%S)
INSTALLED := $(VENV)/.installed
PYTEST := $(BIN)/pytest -n auto --dist loadfile --no-loadscope-reorder

.PHONY: install train test test-all lint format proto docs page clean
install: $(INSTALLED)

$(INSTALLED): pyproject.toml constraints.txt
	@echo 'Installing the player, the trainer and what tests them into $(VENV): about 120 packages, 3 GB, 4 to 5 minutes.'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --constraint constraints.txt --editable '.[dev]'
	@touch $@
	@echo 'Installed. By hand: source $(VENV)/bin/activate, then corridor --help.'

train: $(INSTALLED)  ## train the paper's agent; e.g. make train RUN=mine ARGS='--seed 1 --c 0'
	$(BIN)/corridor train --run-id $(RUN) $(ARGS)

test: $(INSTALLED)  ## run the tests of at most 10 seconds each, in Chromium alone; e.g. make test ARGS=tests/runs
	$(PYTEST) -m 'not slow' $(ARGS)

test-all: $(INSTALLED)  ## run every test, as CI does
	$(PYTEST) $(ARGS)

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

format: $(INSTALLED)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

proto: $(INSTALLED)  ## compile proto/ into the player's descriptor set
	cd proto && ../$(BIN)/python -m grpc_tools.protoc -I. --include_imports \
		--descriptor_set_out=../corridor_server/protocol/messages.binpb $$(find mlagents_envs -name '*.proto' | sort)

page: trainer/viewer/page/node_modules  ## bundle the page's sources (needs Node; only to change the page)
	cd trainer/viewer/page && npm run --silent build

trainer/viewer/page/node_modules: trainer/viewer/page/package-lock.json
	cd trainer/viewer/page && npm ci
	touch $@

docs: $(INSTALLED)  ## write docs/parameters.md's table and docs/presets/ from the code
	$(BIN)/python -c "from pathlib import Path; from corridor_server.corridor.corridor_config import parameter_table; \
		path = Path('docs/parameters.md'); text = path.read_text(); \
		path.write_text(text[:text.index('| name')] + parameter_table() + '\n')"
	$(BIN)/python -c "from pathlib import Path; from trainer.paper_settings import preset_file; from trainer.presets import PRESETS; \
		[Path('docs/presets', f'{name}.yaml').write_text(preset_file(name)) for name in PRESETS]"

clean:
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
