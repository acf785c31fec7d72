# make demo and make test work as the first command on a bare Debian or Ubuntu with Python 3.10 to 3.12 and a C++ compiler.
# On a machine with a full ROS 2 Jazzy, `colcon build` alone builds the same sources.

PYTHON ?= python3
OUT ?= out
SHELL := /bin/bash
VENV := $(CURDIR)/.venv
IN_ENV := source ./env.sh &&
STYLED := neuse bags neuse_encoder_node neuse_slam_node neuse_mapper_node tests tools
NODES := neuse_encoder_node neuse_slam_node neuse_mapper_node bags

MESSAGE_SOURCES := $(wildcard neuse_msgs/*/* neuse_msgs/CMakeLists.txt neuse_msgs/package.xml)
PACKAGE_SOURCES := $(wildcard neuse/CMakeLists.txt neuse/package.xml \
	$(foreach node,$(NODES),$(node)/package.xml $(node)/setup.py $(node)/setup.cfg $(node)/config/* $(node)/*/*.py $(node)/*/*/*.py))
COLCON := env -u PYTHONPATH PATH="$(VENV)/bin:$$PATH" AMENT_PREFIX_PATH="$(VENV)" CMAKE_PREFIX_PATH="$(VENV)" \
	colcon --log-base log build --symlink-install --event-handlers desktop_notification-

.PHONY: demo test setup lint format evaluate evaluate-embedding bench train clean

demo: setup  ## simulate, play, map and evaluate the tabletop world into out/demo/
	$(IN_ENV) ./run.sh neuse_bags demo --out $(OUT)/demo

test: setup
	$(IN_ENV) python -m pytest

setup: install/.packages

$(VENV)/.wheels: requirements.txt pyproject.toml tools/make_venv.sh tools/repair_cmake_exports.py
	tools/make_venv.sh $(PYTHON) $(VENV)
	touch $@

install/.messages: $(MESSAGE_SOURCES) | $(VENV)/.wheels
	rm -rf build/neuse_msgs install/neuse_msgs
	$(COLCON) --packages-select neuse_msgs
	touch $@

install/.packages: install/.messages $(PACKAGE_SOURCES)
	$(COLCON) --packages-skip neuse_msgs
	touch $@

lint: setup
	$(IN_ENV) ruff check $(STYLED) && ruff format --check $(STYLED) && mypy

format: setup
	$(IN_ENV) ruff check --fix $(STYLED) && ruff format $(STYLED)

evaluate: setup  ## the paper's tables: every world through the in-process pipeline
	$(IN_ENV) tools/evaluate_worlds.sh $(OUT)/evaluate

evaluate-embedding: setup  ## held-out views, or real meshes: make evaluate-embedding MESHES=DIR
	$(IN_ENV) python -m neuse.embedding.evaluate --out $(OUT)/embedding $(if $(MESHES),--meshes $(MESHES))

bench: setup  ## the nodes over DDS, then each stage by itself
	$(IN_ENV) ./run.sh neuse_bags bench --out $(OUT)/bench && OPENBLAS_NUM_THREADS=1 python -m neuse.evaluation.bench --out $(OUT)/bench

train: setup
	$(IN_ENV) python -m neuse.embedding.train --compile --install --resume

clean:  ## removes what colcon built and what runs wrote; keeps .venv and data
	rm -rf build install log $(OUT)
