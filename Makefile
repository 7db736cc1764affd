# make demo: the main job on real physics, results in out/    make test: every test but the long ones
# make page: the studio's page and bundles, into its package (make test does it, too)
# make docs: the documentation, readable offline, into site/
# make endurance: every fault and attack, the long ones too; its last line counts them    make fuzz: random input
# make numerics: the tests whose results are numbers, with INSTRUCTION_SET=avx2 or sse4 as on an older processor
# make wheel: what is installed elsewhere, in dist/    make wheels: the studio's, too
# make blender: the extension for Blender, in dist/
# All set up .venv by themselves. PYTHON chooses the interpreter (3.11 or newer).
PYTHON ?= python3
BIN := .venv/bin
# uv where it is installed, otherwise pip, which takes longer.
INSTALL := $(if $(shell command -v uv 2>/dev/null),uv pip install --quiet --python $(BIN)/python,$(BIN)/python -m pip install --quiet)
CORE_STAMP := .venv/.ready-core
STAMP := .venv/.ready
DOCS_STAMP := .venv/.ready-docs
PAGE := studio/neuroanimator_studio/page/index.html
PAGE_SOURCES := $(shell find studio -type f -not -path '*/node_modules/*' -not -path 'studio/neuroanimator_studio/*')
# What takes longest comes first.
BUNDLES := $(foreach name,human dolphin-50 fish-50 truck-50 lander-50 fishes-50 pendulum-50 pendulum-passive-50 trout-32 orca-64 cape-40 flag-40 jelly-40 cube,studio/neuroanimator_studio/bundles/$(name)/bundle.json)

.PHONY: setup studio demo test numerics page bundles docs wheel wheels blender endurance fuzz lint check bench lock clean

demo: $(CORE_STAMP)
	$(BIN)/neuroanimator demo --out out

test: setup studio
	$(BIN)/python studio/build.py test
	$(BIN)/pytest

# No result may hang on the last bits, which other instructions round differently (tests/instruction_sets.py).
ROOMS ?= codegen control emulator gym learn physics state systems
numerics: setup
	$(BIN)/pytest $(addprefix tests/,$(ROOMS))

# A warning is an error, and so is a link that leads nowhere or a page that needs another host (docs/hooks.py).
docs: $(DOCS_STAMP)
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo "The documentation is in site/index.html."

# Built anew each time, from the package alone; tests/test_wheel.py installs it outside the checkout.
wheel: $(CORE_STAMP)
	rm -rf dist
	$(BIN)/python -m hatchling build -t wheel -d dist

# The studio's wheel, too, which holds its page and its bundles.
wheels: wheel page
	cd studio && ../$(BIN)/python -m hatchling build -t wheel -d ../dist

blender: setup
	$(BIN)/python blender/build.py

endurance: setup studio
	$(BIN)/pytest -m "endurance or fault or attack"

# Ten minutes of random input for every parser of strangers' files; `make test` has five seconds of it.
fuzz: setup
	cd tests && ../$(BIN)/python -m fuzz --seconds 600

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

check: lint test

bench: setup
	$(BIN)/python -m benchmarks.equal_error.table1

setup: $(STAMP)

# Without the page everything but the studio works, so that a machine without npm's registry is set up all the same.
studio: $(STAMP)
	@$(MAKE) --no-print-directory page || echo "The studio's page was not built; everything else works. Try again: make page"

# The page, by the machine's Node if that is new enough, or else by the one that PyPI has; and what it shows.
page: $(STAMP)
	@$(MAKE) --no-print-directory -j2 $(PAGE) bundles

# One process makes all that are out of date: what they share is imported and compiled once.
bundles: $(BUNDLES)
	@$(if $(STALE),$(BIN)/python -m neuroanimator_studio.ship $(STALE),:)

studio/neuroanimator_studio/bundles/%/bundle.json: src/neuroanimator/emulators/%.emulator.safetensors | $(STAMP)
	$(eval STALE += $*)

# No emulator of the cube ships: the page runs its physics.
studio/neuroanimator_studio/bundles/cube/bundle.json: src/neuroanimator/systems/assets/cube.toml | $(STAMP)
	$(eval STALE += cube)

# What was learnt in the examples.
studio/neuroanimator_studio/bundles/human/bundle.json: examples/human/human.policy.safetensors examples/human/falls.safetensors | $(STAMP)
	$(eval STALE += human)

$(PAGE): $(PAGE_SOURCES) | $(STAMP)
	@$(BIN)/python studio/build.py

# What the program needs itself: `make demo` and `make wheel` do not wait for what the tests need besides.
$(CORE_STAMP): pyproject.toml constraints-core.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "NeuroAnimator needs Python 3.11 or newer; $(PYTHON) is older. Try: make PYTHON=python3.12 demo"; exit 1; }
	@if command -v uv >/dev/null; then \
	  uv venv --quiet --allow-existing --python $(PYTHON) .venv; \
	else \
	  $(PYTHON) -m venv .venv || { echo "No venv module. On Debian: apt-get install python3-venv"; exit 1; }; \
	fi
	@$(INSTALL) --require-hashes -r constraints-core.txt
	@$(INSTALL) --no-deps --no-build-isolation -e .
	@# Where Python may not keep what it compiles, every process would compile the package anew.
	@test -z "$$PYTHONDONTWRITEBYTECODE" || $(BIN)/python -m compileall -q src
	@touch $@

$(STAMP): $(CORE_STAMP) studio/pyproject.toml constraints.txt
	@$(INSTALL) --require-hashes -r constraints.txt
	@$(INSTALL) --no-deps --no-build-isolation -e studio
	@test -z "$$PYTHONDONTWRITEBYTECODE" || $(BIN)/python -m compileall -q studio/neuroanimator_studio
	@touch $@

# What only the documentation needs: `make demo` and `make test` do not wait for it.
$(DOCS_STAMP): $(STAMP) constraints-docs.txt
	@$(INSTALL) --require-hashes -r constraints-docs.txt
	@touch $@

# Pins every package with its hashes; run after changing dependencies. Needs uv.
lock:
	uv pip compile pyproject.toml --group dev --group build --universal --python-version 3.11 --generate-hashes \
	  --no-emit-index-url --no-annotate --quiet --output-file constraints.txt
	uv pip compile pyproject.toml --group build --constraints constraints.txt --universal --python-version 3.11 \
	  --generate-hashes --no-emit-index-url --no-annotate --quiet --output-file constraints-core.txt
	uv pip compile --group docs --constraints constraints.txt --universal --python-version 3.11 --generate-hashes \
	  --no-emit-index-url --no-annotate --quiet --output-file constraints-docs.txt

clean:
	rm -rf .venv out dist site studio/node_modules studio/neuroanimator_studio/page studio/neuroanimator_studio/bundles
