# make demo    a Franka lifts cubes on MuJoCo; the video lands in out/lift.mp4
# make view    the same, live in the browser
# make test    style, types, all tests, the conformance suite's quick run, and the example backend
# Each sets up the environment in .venv first, as far as it needs it.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
BACKENDS := mujoco bullet sapien warp
LEARNING := rsl-rl,sb3,skrl,rl-games,torchrl,pettingzoo,onnx
# Newton's solvers register as backends only where Newton is installed, which `pip install "orbit-core[newton]"` does.
PLUGINS := mjmodel warpkit $(BACKENDS) newton matter
# What the example backend is asked of the suite: one scenario or two of each capability, without those that take minutes
# in batched torch. `orbit conformance --backend torch --matter native` is the whole.
EXAMPLE_SCENARIOS := free_fall projectile sliding_to_rolling ball_on_slope landing_force contact_force_pairs pivot_in_a_grip \
	ring_on_rod fast_spin spin_down intermediate_axis joint_damping joint_springs joint_friction joint_actuation effort_limits \
	drive_tracking implicit_drive explicit_drive stiff_drive reflected_inertia gains_per_environment mass_per_environment \
	friction_per_environment gravity_per_environment frame_and_joint_sensors imu_in_a_circle magnetic_seal beside_a_reset \
	snapshot resting_weight rays_on_primitives
SOURCES := pyproject.toml constraints.txt $(PLUGINS:%=plugins/orbit-%/pyproject.toml)
CODE := orbit_core orbit_tasks plugins tests benchmarks assets tools examples

.PHONY: demo view test lint types unit coverage conformance example mutants clean

demo: $(VENV)/.ready
	@mkdir -p out
	$(BIN)/orbit run Lift --backend mujoco --num-envs 16 --episodes 64 --agent expert --video out/lift.mp4 --overwrite

view: $(VENV)/.ready
	$(BIN)/orbit view Lift --backend mujoco

test: $(VENV)/.ready-dev lint types unit conformance example

lint: $(VENV)/.ready-dev
	$(BIN)/ruff check $(CODE)
	$(BIN)/ruff format --check $(CODE)

types: $(VENV)/.ready-dev
	$(BIN)/basedpyright --threads

# Test processes share the cores, and torch's threads would only wait for each other.
unit coverage example mutants: export OMP_NUM_THREADS = 1

unit: $(VENV)/.ready-dev
	$(BIN)/pytest -n auto --dist worksteal --ignore tests/conformance/test_scenarios.py

# The same, a third slower, with the share of lines that it runs.
coverage: $(VENV)/.ready-dev
	$(BIN)/pytest -n auto --dist worksteal --ignore tests/conformance/test_scenarios.py --cov --cov-report=term:skip-covered --cov-fail-under=90

# Every scenario (what tests/conformance/test_scenarios.py collects for those who write them) on every backend, quickly;
# every task, every kept policy and every robot of the catalogue on two; robots beside the others, whose workers now and
# then wait for the last of their jobs. `orbit conformance` is the whole matrix; throughput is for idle machines: the
# committed report and benchmarks/ have it.
conformance: $(VENV)/.ready-dev
	$(BIN)/orbit conformance --part robots --backend mujoco sapien --jobs 1 --output out/conformance-robots & \
	$(BIN)/orbit conformance --quick --part scenarios --output out/conformance && \
	$(BIN)/orbit conformance --quick --part tasks transfers --backend mujoco sapien --output out/conformance-tasks && wait $$!

# The backend that docs/write-a-backend.md builds, installed beside the environment so that nothing else sees it, and a
# tenth of its mutants.
example: $(VENV)/.ready-dev
	$(BIN)/pip install --quiet --no-deps --upgrade --target out/orbit-torch examples/orbit-torch
	PYTHONPATH=out/orbit-torch:. $(BIN)/python -m tests.mutants --tenth & \
	export PYTHONPATH=out/orbit-torch && $(BIN)/pytest -n auto -k torch tests/conformance/test_conformance_*.py && \
	$(BIN)/orbit conformance --quick --backend torch --scenario $(EXAMPLE_SCENARIOS) --matter native --output out/conformance-torch \
	&& wait $$!

# The example backend broken in every named way; each mutant must be caught by the tests that it names. Takes minutes.
mutants: $(VENV)/.ready-dev
	$(BIN)/pip install --quiet --no-deps --upgrade --target out/orbit-torch examples/orbit-torch
	PYTHONPATH=out/orbit-torch:. $(BIN)/python -m tests.mutants

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

# Python compiles what it loads and no more, and packages of the system come while pip works. What builds packages is
# installed once, rather than anew for each of them.
PIP := $(BIN)/pip install --quiet --no-compile --no-build-isolation --constraint constraints.txt

$(VENV)/.builders: $(VENV)/bin/python
	$(PIP) hatchling editables setuptools wheel
	touch $@

$(VENV)/.ready: $(VENV)/.builders $(SOURCES)
	sh tools/system_packages.sh graphics & $(PIP) --editable ".[mujoco,robots,usd,mjcf,viewer,video]" && wait $$!
	touch $@

$(VENV)/.ready-dev: $(VENV)/.builders $(SOURCES)
	sh tools/system_packages.sh graphics vulkan browser & $(PIP) --editable \
		".[mujoco,bullet,sapien,warp,robots,decomposition,usd,mjcf,viewer,video,plots,conformance,data,lerobot,zarr,$(LEARNING),dev]" \
		&& wait $$!
	$(PIP) --no-deps crocoddyl libcrocoddyl
	$(PIP) --no-deps $(PLUGINS:%=--editable plugins/orbit-%)
	touch $(VENV)/.ready $@

clean:
	rm -rf $(VENV) out
