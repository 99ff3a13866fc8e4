# Every target sets up what it needs first, and a second run finds it there.
# `make run PYTHON=/usr/bin/python3.12` chooses the Python.

PYTEST_ARGS ?=

# Another environment's modules must not stand in for those of .venv, and each of the many processes
# that tests start would compile every module again.
unexport PYTHONPATH PYTHONHOME PYTHONDONTWRITEBYTECODE

.PHONY: help run try test check lock wheels test-all test-exhaustive test-s3 test-servers test-pipewire test-browser test-usb soak bench docs clean
.NOTPARALLEL:

help:
	@echo 'make run     set up and play the demo scene; results in out/'
	@echo 'make try     set up and serve the page that makes vibration in a browser'
	@echo 'make test    set up and run the fast tests (PYTEST_ARGS="..." for pytest)'
	@echo 'make check   style and types'
	@echo 'make test-all    the fast tests and the five sets below'
	@echo 'make test-exhaustive   more cases of the same properties'
	@echo 'make test-s3           storages with the S3 API'
	@echo 'make test-servers      live sound, on sound servers of its own'
	@echo 'make test-pipewire     the same on PipeWire 1.4 and 1.6, in roots of newer Debians (SUITES="trixie sid")'
	@echo 'make test-browser      the live page, in a browser, on a sound server of its own'
	@echo 'make test-usb          USB sound cards of a real kernel, in a virtual machine'
	@echo 'make soak    the tests that take minutes'
	@echo 'make bench   measure speed and error on this machine'
	@echo 'make docs    build the pages of docs/ as a site in out/site'
	@echo 'make wheels  build dist/*.whl for x86-64 and ARM64, with a compiler from PyPI'
	@echo 'make lock    choose the newest versions of all packages anew: constraints.txt'
	@echo 'make clean   remove what the set-up and the tests made; out/ stays'

run:
	@sh tools/setup.sh run
	.venv/bin/cushion demo

try:
	@sh tools/setup.sh run
	.venv/bin/python -m tools.try_page --serve

test:
	@sh tools/setup.sh test
	@sh tools/fetch_recordings.sh
	@sh tools/fetch_usb_mock.sh
	.venv/bin/python -m pytest -n auto --dist loadfile $(PYTEST_ARGS)

check:
	@sh tools/setup.sh test
	.venv/bin/python -m ruff check .
	.venv/bin/python -m ruff format --check .
	.venv/bin/python -m mypy --strict

wheels:
	@sh tools/setup.sh test
	@sh tools/wheels.sh

# One file for all Pythons and extras. Only this target needs uv.
lock:
	@sh tools/setup.sh run
	.venv/bin/python -m pip install --quiet --target .cache/uv uv
	.cache/uv/bin/uv pip compile --quiet --upgrade --universal --python-version 3.11 --fork-strategy fewest \
	    --all-extras --no-annotate --custom-compile-command 'make lock' --output-file constraints.txt pyproject.toml

test-all: check test test-exhaustive test-s3 test-servers test-browser test-usb

test-s3:
	@sh tools/setup.sh s3
	.venv/bin/python -m pytest -m s3 $(PYTEST_ARGS) tests/catalogue

test-exhaustive:
	@sh tools/setup.sh test
	@sh tools/fetch_recordings.sh
	@sh tools/fetch_usb_mock.sh
	.venv/bin/python -m pytest \
	    -m "exhaustive and not soak and not servers and not usbvm and not browser and not s3" \
	    -n auto --dist worksteal $(PYTEST_ARGS)

test-servers:
	@sh tools/setup.sh test
	@sh tools/fetch_recordings.sh
	@sh tools/fetch_servers.sh
	@# Most tests wait for sound to play; what is measured exactly shares the machine with one other.
	@failed=0; \
	.venv/bin/python -m pytest -m "servers and not calm and not soak" -n 3 --dist worksteal $(PYTEST_ARGS) \
	    tests/servers tests/monitor || failed=1; \
	.venv/bin/python -m pytest -m "servers and calm and not soak" -n 2 --dist worksteal $(PYTEST_ARGS) \
	    tests/servers || failed=1; \
	exit $$failed

SUITES ?= trixie sid

test-pipewire:
	@failed=0; for suite in $(SUITES); do \
	    echo "== $$suite"; \
	    bash tools/debian_root.sh $$suite make test-servers PYTEST_ARGS='$(PYTEST_ARGS)' || failed=1; \
	done; exit $$failed

test-browser:
	@sh tools/setup.sh test
	@sh tools/fetch_servers.sh
	@sh tools/fetch_browser.sh
	.venv/bin/python -m pytest -m "browser and not soak" $(PYTEST_ARGS) tests/browser

test-usb:
	@sh tools/setup.sh test
	@sh tools/fetch_servers.sh
	@sh tools/fetch_usb_vm.sh
	.venv/bin/python -m pytest -m "usbvm and not soak" -n 2 --dist worksteal $(PYTEST_ARGS) tests/usbvm

soak:
	@sh tools/setup.sh test
	@sh tools/fetch_recordings.sh
	@sh tools/fetch_servers.sh
	@sh tools/fetch_browser.sh
	.venv/bin/python -m pytest -m soak $(PYTEST_ARGS)

bench:
	@sh tools/setup.sh test
	@sh tools/fetch_recordings.sh
	@sh tools/fetch_sounds.sh
	.venv/bin/python -m tools.bench --out docs/benchmarks.md --tables docs/benchmarks $$(.venv/bin/python -c 'import matplotlib' 2>/dev/null && echo --plots docs/images)
	@echo '.venv/bin/python -m tools.docs --write   puts the new figures into the other pages'

docs:
	@sh tools/setup.sh docs
	.venv/bin/python -m tools.docs
	NO_MKDOCS_2_WARNING=1 .venv/bin/python -m mkdocs build --strict --clean
	.venv/bin/python -m tools.try_page
	@echo 'out/site/index.html'

clean:
	rm -f audioflinger_hook/core/*.so device/*.so
	rm -rf .venv .cache .pytest_cache .mypy_cache .ruff_cache .hypothesis build dist *.egg-info
	find audioflinger_hook device tests tools -type d -name __pycache__ -exec rm -rf {} +
