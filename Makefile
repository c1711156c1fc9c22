# Everything needs only make and Python 3.10 to 3.14; the rest is installed into .venv.
# ARGS is passed on:  make run ARGS="--duration 10 --seed 2"    make test ARGS="-k spectra -x"

VENV := .venv
BIN := $(VENV)/bin

# A ROS installation sourced in this shell, or a caller that itself runs from an environment of ROS
# wheels, would mix its own modules and libraries with those of .venv.
# Compiled modules are kept, or every process would compile them anew.
unexport PYTHONHOME PYTHONPATH PYTHONDONTWRITEBYTECODE RMW_IMPLEMENTATION AMENT_PREFIX_PATH
ifneq ($(ROS_DISTRO)$(_ROS_WHEELS_BOOTSTRAP_COMPLETE),)
unexport LD_LIBRARY_PATH
endif
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE

.DEFAULT_GOAL := help
.PHONY: help setup run test test-all compiled bench research pictures colcon lint format lock sbom clean

help:  ## list what make can do here
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "make %-8s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup:  ## make or update .venv, with the command .venv/bin/armimp
	@scripts/setup.sh

run: setup  ## set up, then run the default experiment (or as ARGS say)
	@$(BIN)/armimp run $(ARGS)

test: setup  ## check style and types, then run the tests that a person waits for, in five minutes
	@$(MAKE) --no-print-directory -j2 lint compiled
	@scripts/test.sh $(ARGS)

test-all: setup  ## run every test: each page, colcon, campaigns, every kill; hours on two cores
	@$(MAKE) --no-print-directory -j2 lint compiled
	@scripts/test.sh --all $(ARGS)

compiled: setup
	@PYTHONPATH=tests $(BIN)/python -m support.compiled

bench: setup  ## measure what a run costs here, e.g. ARGS="start growth"
	@PYTHONPATH=tests $(BIN)/python -m benchmarks $(ARGS)

research: setup  ## repeat a study of research/, e.g. ARGS="limits --seeds 0:8"
	@$(BIN)/python -m research $(ARGS)

pictures: setup  ## make the pictures of README and docs whose sources have changed, or those in ARGS
	@$(BIN)/python scripts/make_pictures.py $(ARGS)

colcon: setup  ## build the workspace with colcon, as a full ROS 2 does, and run all its tests
	cd ros2_ws && ../$(BIN)/python -m colcon build --base-paths src ../examples --symlink-install
	cd ros2_ws && ../$(BIN)/python -m colcon test --base-paths src ../examples \
		--return-code-on-test-failure $(ARGS)
	cd ros2_ws && ../$(BIN)/python -m colcon test-result

lint: setup  ## check style and types only
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

format: setup  ## format the sources and repair what can be repaired
	$(BIN)/ruff check --fix-only
	$(BIN)/ruff format

lock:  ## pin the requirements anew (needs the network)
	scripts/lock.sh --upgrade

sbom: setup  ## write sbom.json, the bill of materials of .venv (CycloneDX)
	$(BIN)/cyclonedx-py environment --pyproject pyproject.toml --output-file sbom.json $(BIN)/python

clean:  ## remove .venv, builds and caches, but no results
	rm -rf $(VENV) build install log .mypy_cache .ruff_cache .pytest_cache .hypothesis
	rm -rf ros2_ws/build ros2_ws/install ros2_ws/log
	rm -rf ros2_ws/src/*/build ros2_ws/src/*/*.egg-info examples/*/build examples/*/*.egg-info
	find ros2_ws examples tests -type d -name __pycache__ -prune -exec rm -rf {} + 2>/dev/null || true
