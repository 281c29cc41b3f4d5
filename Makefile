# `make demo` and `make test` are all a new user needs; both do every bit of set-up on a fresh Debian 12.

UV_VERSION := 0.13.8
UV         := .tools/bin/uv
BIN        := .venv/bin

# Containers are often made with the first set: then every process compiles all it imports anew, 3 s of each, and a scan
# has eight. So what is installed is compiled by whoever installs it, once, and annulus itself by `setup`.
export PYTHONDONTWRITEBYTECODE :=
export UV_COMPILE_BYTECODE := 1

# What `make setup` installs beside the base, of the extras in pyproject.toml: make setup EXTRAS="export pdf tai joints"
EXTRAS ?= export pdf console archive

.PHONY: setup setup-all wheels demo test test-deep test-held tested durations lint bench bench-metrology bench-thermoacoustic bench-joints bench-crossbore study native firmware emulator generated mutants docs sample clean

# What a user needs.
setup: .venv/.synced native
	@$(BIN)/python -m compileall -q host/annulus_pipe
	@$(if $(filter command% environment%,$(origin EXTRAS)),$(UV) sync --frozen --inexact --no-dev $(EXTRAS:%=--extra %) --quiet)

# .. and what only tests and checks do: all extras, all development tools.
setup-all: .venv/.synced-all setup

# uv in a private venv, so that nothing of the system's Python is touched.
$(UV):
	@tools/need.sh python3-venv
	python3 -m venv .tools
	.tools/bin/pip install --quiet --disable-pip-version-check uv==$(UV_VERSION)

.venv/.synced: pyproject.toml uv.lock | $(UV)
	$(UV) sync --frozen --inexact --no-dev $(EXTRAS:%=--extra %) --quiet
	@touch $@

.venv/.synced-all: pyproject.toml uv.lock | $(UV)
	$(UV) sync --frozen --all-extras --all-groups --quiet
	@touch .venv/.synced $@

# The controller's C code on a simulated board, and the loops of the measuring methods: into host/annulus_pipe/shipped.
native:
	@tools/need.sh gcc
	@$(MAKE) --silent -C firmware native
	@$(MAKE) --silent -C host/native

# The images for the Pico: firmware/build/annulus.uf2 and .elf, budgets printed, and rig.uf2 for a second one that tests
# the first; both UF2 also in host/annulus_pipe/shipped.
firmware:
	@tools/need.sh gcc-arm-none-eabi
	@$(MAKE) --silent -C firmware image rig

# What runs that image without a board.
emulator: tools/emulator/node_modules/.package-lock.json

tools/emulator/node_modules/.package-lock.json: tools/emulator/package.json tools/emulator/package-lock.json
	@tools/need.sh nodejs npm
	@cd tools/emulator && npm ci --silent --no-audit --no-fund
	@touch $@

# dist/: of both machines, with the library, the image and the manual inside. What they hold: tools/wheel/hook.py.
wheels: setup-all docs
	@tools/need.sh gcc-arm-none-eabi gcc-aarch64-linux-gnu
	@for machine in x86_64 aarch64; do ANNULUS_MACHINE=$$machine $(BIN)/hatchling build -t wheel -d dist || exit 1; done
	@ls -l dist/*.whl

demo: setup
	$(BIN)/annulus demo

# The gate: one case of every promise. Lint first: it fails fast. One queue, dearest files first (tests/durations.json);
# those that promise something in seconds by themselves at the end. No skips: tests/conftest.py.
# `make test ROOM=wall`: lint, types and the gate's tests of that room, and nothing else.
GATE := not deep
ifeq ($(origin ROOM),command line)
test: .venv/.synced-all native
	@$(BIN)/python -m tools.room "$(ROOM)"
else
test: tested
endif

# The gate and all other sizes, seeds and parameters.
test-deep: GATE := deep or not deep
test-deep: tested

# What each test file costs, measured anew into tests/durations.json: `make durations` of the gate, `make durations GATE=deep`.
durations: RENEW := --renew-durations
durations: tested

tested: export ANNULUS_NO_SKIPS := 1
tested: setup-all lint firmware emulator .tools/picamera2/.made
	@tools/need.sh clang libclang-rt sigrok-cli qemu-system-x86 linux-image-amd64 busybox-static kmod \
	  gcc-aarch64-linux-gnu qemu-user-static systemd chromium pango poppler-utils povray
	@$(MAKE) --silent -C host/native MACHINE=aarch64 CC=aarch64-linux-gnu-gcc BUILD=build/aarch64
	$(BIN)/pytest -n auto --dist loadfile --max-worker-restart 0 $(RENEW) -m "($(GATE)) and not alone" tests --ignore tests/held
	$(BIN)/pytest $(RENEW) -m "($(GATE)) and alone" tests --ignore tests/held

# Whole methods on scenes that other programs drew: they lie in ../shared, which only the authors have.
test-held: setup-all
	$(BIN)/pytest -n auto --dist loadfile tests/held

# Picamera2's own code, which the tests run off a Pi; by itself, since what it depends on is only on a Pi.
.tools/picamera2/.made: tests/unit/capture/picamera2.txt .venv/.synced-all
	@$(UV) pip install --quiet --no-deps --require-hashes --target $(@D) -r $<
	@touch $@

lint: setup-all generated
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/clang-format --dry-run --Werror $$(git ls-files 'firmware/*.[ch]' 'host/native/*.[ch]' 'tests/*.[ch]')

generated:
	python3 protocol/generate.py --check

bench: setup-all firmware emulator
	$(BIN)/python -m tools.bench speed

# The table of tools/bench/metrology/RESULTS.md and its pictures, anew.
bench-metrology: setup-all
	$(BIN)/python -m tools.bench metrology

bench-thermoacoustic: setup-all
	$(BIN)/python -m tools.bench thermoacoustic

bench-joints: setup-all
	$(BIN)/python -m tools.bench joints

bench-crossbore: setup-all
	$(BIN)/python -m tools.bench crossbore

# The source's figures and tables, simulated: pictures and numbers in build/study.
study: setup-all
	$(BIN)/python -m tools.study --out build/study

# The manual, into host/annulus_pipe/shipped/manual; `annulus docs` opens it. Any warning fails it; nothing is fetched.
docs: setup-all
	@$(BIN)/python -m tools.manual

# A recording to try everything on, as a wheel of its own: dist/annulus_sample-*.whl, put into this checkout's environment
# too, so that `annulus sample` finds it.
sample: setup-all
	@$(BIN)/python -m tools.sample
	@$(UV) build --quiet --wheel --out-dir dist tools/sample
	@$(UV) pip install --quiet --no-deps --reinstall dist/annulus_sample-*.whl
	@ls -l dist/annulus_sample-*.whl

# Faults put into the firmware on purpose; the emulator's tests must catch every one.
mutants: setup-all firmware emulator
	$(BIN)/python tools/mutants.py

clean:
	rm -rf .venv .tools firmware/build host/native/build tools/emulator/node_modules dist
