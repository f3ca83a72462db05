# make demo    a Franka lifts cubes on MuJoCo; the video lands in out/lift.mp4
# make view    the same, live in the browser
# make test    style, types of a sixth of the files, all fast tests, a sixtieth of the slow ones and of the conformance suite
# make test-all  everything
# make docs    the documentation site, strictly, into out/site; make docs-view serves it
# Each sets up the environment in .venv first, as far as it needs it.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
BACKENDS := mujoco bullet sapien warp
LEARNING := rsl-rl,sb3,skrl,rl-games,torchrl,pettingzoo,onnx,sweep,wandb,trackio
# Newton's solvers register as backends only where Newton is installed, which `pip install "orbit-core[newton]"` does.
PLUGINS := mjmodel warpkit $(BACKENDS) newton matter
# What the example backend is asked of the suite: one scenario or two of each capability, without those that take minutes
# in batched torch. `orbit conformance --backend torch --matter native` is the whole.
EXAMPLE_SCENARIOS := free_fall projectile sliding_to_rolling ball_on_slope landing_force contact_force_pairs pivot_in_a_grip \
	ring_on_rod fast_spin spin_down intermediate_axis joint_damping joint_springs joint_friction joint_actuation effort_limits \
	drive_tracking implicit_drive explicit_drive stiff_drive reflected_inertia gains_per_environment mass_per_environment \
	friction_per_environment gravity_per_environment frame_and_joint_sensors imu_in_a_circle magnetic_seal beside_a_reset \
	snapshot resting_weight rays_on_primitives
# ORBIT's own distributions lie in this checkout; what `.[EXTRAS]` asks for is found among what is named with it.
OWN := . $(wildcard packages/orbit-*) $(wildcard bridges/orbit-*) ./orbit_tasks tests/conformance
SOURCES := checkout.txt constraints.txt $(OWN:%=%/pyproject.toml) $(PLUGINS:%=plugins/orbit-%/pyproject.toml)
CODE := orbit_core orbit_tasks packages bridges plugins tests benchmarks assets tools examples

# Kernels, compiled steps, parsed robots and wheels may be kept between runs, and runs may share them.
export ORBIT_TEST_CACHE ?= $(HOME)/.cache/orbit-tests
# Bytecode is written, whatever the machine's habit: nothing is compiled by pip, and torch takes 5 s to compile.
unexport PYTHONDONTWRITEBYTECODE
CACHED := sh tools/with_caches.sh
PYTEST := $(CACHED) $(BIN)/pytest -n auto --dist worksteal
# Every scenario is a test as well, for those who write them; `conformance` runs them here.
UNITS := --ignore tests/conformance/test_scenarios.py
# Robots in real time have no other tests beside them; they come first, so that two processes find bytecode that one wrote.
REAL_TIME := tests/deploy tests/ros

.PHONY: demo view test test-all lint types types-turn unit unit-all coverage conformance conformance-all example example-all mutants \
	slow-list docs docs-view wheels check-wheels report-archive release clean

demo: $(VENV)/.ready
	@mkdir -p out
	$(BIN)/orbit run Lift --backend mujoco --num-envs 16 --episodes 64 --agent expert --video out/lift.mp4 --overwrite

view: $(VENV)/.ready
	$(BIN)/orbit view Lift --backend mujoco

# All fast tests, a sixtieth of the slow ones that changes with each commit, and the slow ones that a change concerns.
# Style, and types of a sixth of the files, are checked beside them, by one thread: two would take 1.6 times as much of the
# cores in all.
test: $(VENV)/.ready-dev
	@mkdir -p out
	nice $(MAKE) lint types-turn >out/style.txt 2>&1 & $(MAKE) unit conformance example; failed=$$?; \
		wait $$! || failed=1; cat out/style.txt; exit $$failed

# Everything, once.
test-all: $(VENV)/.ready-dev lint types unit-all conformance-all example-all

lint: $(VENV)/.ready-dev
	$(BIN)/ruff check $(CODE)
	$(BIN)/ruff format --check $(CODE)
	$(BIN)/python tools/docs_site.py check

types: $(VENV)/.ready-dev
	$(BIN)/basedpyright

types-turn: $(VENV)/.ready-dev
	$(BIN)/python -m tests.tiers types

# Test processes share the cores, and torch's threads would only wait for each other.
unit unit-all coverage example example-all mutants: export OMP_NUM_THREADS = 1
unit-all coverage example-all: export ORBIT_TEST_ALL = 1

unit: TIER := --tier quick
unit unit-all: $(VENV)/.ready-dev
	$(CACHED) $(BIN)/pytest $(REAL_TIME) $(TIER) --durations-to out/durations/real_time.json
	$(PYTEST) $(UNITS) $(REAL_TIME:%=--ignore %) $(TIER) --durations-to out/durations/units.json

# The same, a third slower, with the share of lines that it runs.
coverage: $(VENV)/.ready-dev
	$(PYTEST) $(UNITS) --cov --cov-report=term:skip-covered --cov-fail-under=90

conformance: $(VENV)/.ready-dev
	$(CACHED) $(BIN)/python -m tests.tiers conformance

# Every scenario (what tests/conformance/test_scenarios.py collects for those who write them) on every backend, quickly;
# every task, every kept policy and every robot of the catalogue on two; robots beside the others, whose workers now and
# then wait for the last of their jobs. `orbit conformance` is the whole matrix; throughput is for idle machines: the
# committed report and benchmarks/ have it.
conformance-all: $(VENV)/.ready-dev
	$(CACHED) $(BIN)/orbit conformance --part robots --backend mujoco sapien --jobs 1 --output out/conformance/robots & \
	$(CACHED) $(BIN)/orbit conformance --quick --part scenarios --output out/conformance/scenarios && \
	$(CACHED) $(BIN)/orbit conformance --quick --part tasks transfers --backend mujoco sapien --output out/conformance/tasks \
	&& wait $$!

# The backend that docs/write-a-backend.md builds, installed next to the environment so that nothing else sees it, and a
# sixtieth of its scenarios and mutants.
EXAMPLE := PYTHONPATH=out/orbit-torch:. $(CACHED)
EXAMPLE_TESTS := -k torch tests/conformance/orbit_conformance/contract/test_conformance_*.py
EXAMPLE_RUN := conformance --quick --fresh --backend torch --matter native --output out/conformance-torch --scenario

out/orbit-torch: $(VENV)/.ready-dev $(shell find examples/orbit-torch -name '*.py')
	$(INSTALL) --no-deps --upgrade --target out/orbit-torch examples/orbit-torch
	@touch $@

# There are fewer scenarios than turns: a share may be none, and no name would run the whole suite.
example: out/orbit-torch
	$(EXAMPLE) $(BIN)/python -m tests.mutants --turn $$($(BIN)/python -m tests.tiers turn) & \
	share=$$($(BIN)/python -m tests.tiers share $(EXAMPLE_SCENARIOS)) && \
	$(EXAMPLE) $(BIN)/pytest $(EXAMPLE_TESTS) --tier quick --durations-to out/durations/example.json && \
	{ test -z "$$share" || $(EXAMPLE) $(BIN)/orbit $(EXAMPLE_RUN) $$share; } && wait $$!

example-all: out/orbit-torch
	$(EXAMPLE) $(BIN)/python -m tests.mutants --turn $$($(BIN)/python -m tests.tiers turn) & \
	$(EXAMPLE) $(BIN)/pytest -n auto $(EXAMPLE_TESTS) --durations-to out/durations/example.json && \
	$(EXAMPLE) $(BIN)/orbit $(EXAMPLE_RUN) $(EXAMPLE_SCENARIOS) && wait $$!

# The example backend broken in every named way; each mutant must be caught by the tests that it names: some 16 minutes of
# a core.
mutants: out/orbit-torch
	$(EXAMPLE) $(BIN)/python -m tests.mutants

# Bring the list of slow tests up to what the last `make test` or `make test-all` measured.
slow-list: $(VENV)/.ready-dev
	$(BIN)/python -m tests.tiers refresh

# The documentation site into out/site. A link, an anchor or a name that leads nowhere, or a page that loads something from
# another host, fails the build.
docs: $(VENV)/.ready-dev
	$(BIN)/python tools/docs_site.py build

docs-view: $(VENV)/.ready-dev
	$(BIN)/python tools/docs_site.py serve

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

# Python compiles what it loads and no more. What builds packages is installed once, rather than anew for each of them.
INSTALL := $(CACHED) $(BIN)/python tools/install.py --no-build-isolation --constraint constraints.txt

$(VENV)/.builders: $(VENV)/bin/python
	$(INSTALL) hatchling editables setuptools wheel
	touch $@

# What the demonstrations need and no more: OpenUSD and the suite's packages would take a third of the time.
DEMO := assets data learn motion policies viewer

$(VENV)/.ready: $(VENV)/.builders $(SOURCES)
	sh tools/system_packages.sh graphics & $(INSTALL) --editable . $(DEMO:%=--editable packages/orbit-%) \
		--editable ./orbit_tasks --editable plugins/orbit-mjmodel --editable plugins/orbit-mujoco \
		--editable ".[robots,viewer,video]" && wait $$!
	touch $@

$(VENV)/.ready-dev: $(VENV)/.builders $(SOURCES)
	sh tools/system_packages.sh graphics vulkan browser & $(INSTALL) -r checkout.txt \
		$(PLUGINS:%=--editable plugins/orbit-%) \
		--editable ".[robots,decomposition,usd,mjcf,viewer,video,plots,conformance,data,lerobot,zarr,deploy,ros,scenes,scan,sound,editor,$(LEARNING),docs,dev]" \
		&& wait $$!
	$(INSTALL) --no-deps crocoddyl libcrocoddyl
	touch $(VENV)/.ready $@

$(VENV)/.ready-release: $(VENV)/.builders
	$(INSTALL) twine
	touch $@

# Wheels and source archives of every distribution, and a check that they install and run without this checkout.
wheels: $(VENV)/.ready-release
	rm -rf dist && mkdir -p dist
	for folder in $(OWN) $(PLUGINS:%=plugins/orbit-%); do \
		(cd $$folder && $(abspath $(BIN))/hatchling build -d $(CURDIR)/dist >/dev/null) || exit 1; done
	$(BIN)/twine check --strict dist/*

check-wheels: wheels
	PYTHON=$(PYTHON) sh tools/check_wheels.sh dist examples/orbit-torch

# The compact report for docs/conformance, and the whole of it as an archive for the release: RUNS are folders of
# finished runs, the last archive, unpacked, among them.
report-archive: $(VENV)/.ready-dev
	$(BIN)/orbit conformance publish $(RUNS) --output docs/conformance --archive out/release \
		--benchmarks docs/figures/gpu_rates.json

# What a release would upload and tag, after checks of version, changes and archives; uploads nothing.
release: wheels
	$(BIN)/python tools/release.py check dist

clean:
	rm -rf $(VENV) out
