# `make demo` and `make test` are all a new user needs; both do every bit of set-up on a fresh Debian 12.

UV_VERSION := 0.13.8
UV         := .tools/bin/uv
BIN        := .venv/bin

.PHONY: setup demo test lint bench native generated clean

setup: .venv/.synced native

# uv in a private venv, so that nothing of the system's Python is touched.
$(UV):
	@tools/need.sh python3-venv
	python3 -m venv .tools
	.tools/bin/pip install --quiet --disable-pip-version-check uv==$(UV_VERSION)

.venv/.synced: pyproject.toml uv.lock | $(UV)
	$(UV) sync --frozen --quiet
	@touch $@

native:
	@$(MAKE) --silent -C firmware native

demo: setup
	$(BIN)/annulus demo

# Lint first: it fails fast. Firmware tests need clang's fuzzer and sanitizers, which need.sh installs.
test: setup lint
	@tools/need.sh clang libclang-rt
	$(BIN)/pytest -n auto --dist loadfile tests/unit
	$(BIN)/pytest tests/system

lint: setup generated
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/clang-format --dry-run --Werror $$(git ls-files 'firmware/*.c' 'firmware/*.h' 'tests/*.c' 'tests/*.h')

generated:
	python3 protocol/generate.py --check

bench: setup
	@for b in tools/bench/bench_*.py; do echo "== $$b"; $(BIN)/python $$b || exit 1; done

clean:
	rm -rf .venv .tools firmware/build
