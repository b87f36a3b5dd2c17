# Two commands: `make demo` shows a robot being taught, `make test` runs the tests. Each sets up what it needs.
# DEMO_ARGS, TEST_ARGS and BENCH_ARGS are handed on: make demo DEMO_ARGS="--robot ur10 --seed 3"

PYTHON ?= python3
BIN := .venv/bin

# One thread a process: several share the cores, and torch with more threads than free cores is far slower.
export OMP_NUM_THREADS := 1
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST

.PHONY: setup demo test lint bench policies clean

setup:
	@command -v $(PYTHON) > /dev/null || { echo "setup: no $(PYTHON): sudo apt install python3" >&2; exit 2; }
	@$(PYTHON) scripts/setup.py

# The newest demo is in out/demo; an older one keeps its recording under the name of its time.
demo: setup
	@if [ -e out/demo ]; then mv out/demo out/demo-$$(date -r out/demo +%Y%m%d-%H%M%S); fi
	$(BIN)/unifeed demo --out out/demo $(DEMO_ARGS)

# Tests that start nodes want the machine for themselves; of the rest, two files run at once.
test: setup
ifdef TEST_ARGS
	$(BIN)/python -m pytest $(TEST_ARGS)
else
	$(BIN)/python -m pytest --ignore test/ros --numprocesses 2 --dist loadfile --durations=10
	$(BIN)/python -m pytest test/ros --durations=10
endif

lint: setup
	$(BIN)/ruff check .
	$(BIN)/mypy

bench: setup
	$(BIN)/unifeed bench lesson $(BENCH_ARGS)

# The libraries that train the compared policies (BC, AIRL, Atari of `unifeed experiment multimodal`); 1.5 GB.
policies: .venv-policies/made
.venv-policies/made: requirements-policies.txt
	rm -rf .venv-policies
	$(PYTHON) -m venv .venv-policies
	.venv-policies/bin/python -m pip install --quiet --requirement requirements-policies.txt
	.venv-policies/bin/python -P unifeed_ros/baselines/policy_worker.py < /dev/null
	touch $@

clean:
	rm -rf .venv .venv-policies build install log out .pytest_cache .ruff_cache .mypy_cache .hypothesis *.egg-info
	find unifeed_ros test scripts launch -name __pycache__ -type d -prune -exec rm -rf {} +
