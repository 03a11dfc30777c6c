# Installs, runs and tests the project.
#   PYTHON=python3.12 make install        create .venv with another interpreter
#   CONFIG=experiments/x.toml make run    run another experiment

PYTHON ?= python3
CONFIG ?= experiments/miniwob_four.toml
BIN := .venv/bin
STAMP := .venv/.installed

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.ONESHELL:
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help
.PHONY: help install browser run test test-fast check image clean

# install_packages WHAT PACKAGE...: runs apt-get as root or through sudo. Without either it prints the command to type.
define INSTALL_PACKAGES
install_packages() {
  local what=$$1 as_root=(); shift
  if ! command -v apt-get >/dev/null; then
    echo "make: $$what is missing and this system has no apt-get: install $$* with your package manager" >&2; exit 1
  fi
  if [ "$$(id -u)" -ne 0 ]; then
    if command -v sudo >/dev/null && { [ -t 0 ] || sudo -n true 2>/dev/null; }; then as_root=(sudo)
    else echo "make: $$what is missing, type: sudo apt-get install $$*" >&2; exit 1; fi
  fi
  echo "make: $$what is missing, installing $$*"
  "$${as_root[@]}" apt-get -qq -o DPkg::Lock::Timeout=300 update
  "$${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
    apt-get -qq -y -o DPkg::Lock::Timeout=300 install "$$@" >/dev/null
}
endef

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/make \1\t\2/p' Makefile | expand -t 18

install: browser $(STAMP) ## install Chromium, its driver and .venv with all extras; does nothing if they exist

# The packages are chromium and chromium-driver on Debian, chromium-browser and chromium-chromedriver on Ubuntu.
browser:
	@$(INSTALL_PACKAGES)
	chrome=$${GIIRL_CHROME:-chromium} driver=$${GIIRL_CHROMEDRIVER:-chromedriver}
	if command -v "$$chrome" >/dev/null && command -v "$$driver" >/dev/null; then exit 0; fi
	for name in GIIRL_CHROME GIIRL_CHROMEDRIVER; do
	  if [ -n "$${!name:-}" ] && ! command -v "$${!name}" >/dev/null; then
	    echo "make: $$name is $${!name}, which is not a program: correct it or unset it" >&2; exit 1
	  fi
	done
	if grep -qs '^ID=ubuntu' /etc/os-release
	then install_packages Chromium chromium-browser chromium-chromedriver
	else install_packages Chromium chromium chromium-driver
	fi

# The lock makes a second make that runs at the same time wait and then find the work done.
$(STAMP): pyproject.toml constraints.txt
	@$(INSTALL_PACKAGES)
	exec 9>.install.lock; flock 9
	if [ $(STAMP) -nt pyproject.toml ] && [ $(STAMP) -nt constraints.txt ]; then exit 0; fi
	if ! $(BIN)/python -m pip --version >/dev/null 2>&1; then
	  if ! command -v "$(PYTHON)" >/dev/null; then
	    if [ "$(PYTHON)" != python3 ]; then echo "make: PYTHON is $(PYTHON), which is not a program" >&2; exit 1; fi
	    install_packages Python python3 python3-venv
	  fi
	  if ! "$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then
	    echo "make: $$("$(PYTHON)" --version) is too old, wanted 3.11 or newer: make PYTHON=python3.11 ..." >&2
	    exit 1
	  fi
	  if ! "$(PYTHON)" -c 'import ensurepip, venv' 2>/dev/null; then
	    install_packages "the venv module of $(PYTHON)" python3-venv
	  fi
	  "$(PYTHON)" -m venv --clear .venv
	fi
	$(BIN)/python -m pip install --no-input --disable-pip-version-check -c constraints.txt -e '.[all,dev]'
	touch $(STAMP)

run: install ## train on the four tasks of the thesis, or with CONFIG
	@$(BIN)/giirl train $(CONFIG)

# All tests run on all cores; those that start Chrome or Ray and the long ones, file by file.
FAST := not chrome and not ray and not slow

test: check test-fast ## run every check and every test, as CI does
	@$(BIN)/python -m pytest -n logical --dist loadfile -m "chrome and not ray and not slow"
	@$(BIN)/python -m pytest -n $$(($$(nproc) + 1)) --dist loadfile --no-loadscope-reorder -m "slow or ray"

test-fast: install ## run the tests that start neither Ray nor Chrome and take seconds
	@$(BIN)/python -m pytest -n logical -m "$(FAST)"

check: install ## check style, types and import contracts
	@$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python -m mypy
	$(BIN)/lint-imports

image: install ## build the image of a node from Debian packages; needs root, mmdebstrap and buildah
	@deploy/image/build.sh

clean: ## remove .venv and all caches, but not runs/
	@rm -rf .venv .install.lock build dist *.egg-info
	rm -rf .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
