# make demo   the main job, start to finish: 43,008 agents stepped, then a policy learned
# make test   the whole test suite
# Both set up everything they need in .venv; all they ask for is python3 (3.11 or later), make, perl
# and a C++ compiler.

PYTHON ?= python3
VENV := .venv
RLLIB := .venv-rllib
TORCHRL := .venv-torchrl
PEERS := .venv-peers
CLIENTS := .venv-clients
BIN := $(VENV)/bin
OUT ?= out
CORES := $(shell nproc 2>/dev/null || echo 2)
PACKAGE := pyproject.toml constraints.txt
PIP = $(BIN)/python -W ignore -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt

.PHONY: demo test test-exhaustive test-rllib test-torchrl test-peers test-clients test-cuda test-docs lint format bench bench-peers figures tables ulx3s docs dist clean
.DELETE_ON_ERROR:

# Compiled modules are kept even where the environment says not to: the tests start hundreds of processes, and each
# would compile all that it imports.
unexport PYTHONDONTWRITEBYTECODE

demo: $(VENV)/.render
	$(BIN)/pearl run CliffWalking --n-agents 43008 --steps 1000 --out $(OUT)/demo
	$(BIN)/python experiments/cliff_walking_q_learning.py --out $(OUT)/demo

test: $(VENV)/.dev
	$(BIN)/python -m pytest -n $(CORES) --dist loadgroup --slow

# The same with what repeats it at more sizes or for longer, and every proof.
test-exhaustive: $(VENV)/.dev
	$(BIN)/python -m pytest -n $(CORES) --dist loadgroup --slow --exhaustive

# RLlib pins Gymnasium 1.2.2, so it has an environment of its own, and the Gymnasium interface is tested there too.
test-rllib: $(RLLIB)/.rllib
	$(RLLIB)/bin/python -m pytest --slow tests/wrappers/test_rllib.py tests/interfaces/test_vector_env.py tests/docs/test_docs.py -k "not docs or RLlib"

# BenchMARL takes TorchRL below 0.12, and `make test` has those; this is the newest there was.
test-torchrl: $(TORCHRL)/.torchrl
	$(TORCHRL)/bin/python -m pytest --slow tests/wrappers/test_torchrl.py tests/docs/test_docs.py -k "not docs or TorchRL"

# The benchmark of whole trainings with all that it compares: gymnax takes Gymnasium below 1.4, so they have an
# environment of their own.
test-peers: $(PEERS)/.peers
	$(PEERS)/bin/python -m pytest --slow tests/benchmarks/test_training.py tests/benchmarks/test_rollouts.py

# Packages that nobody here wrote, on environments as they are; `make test` runs those that the other environment has.
test-clients: $(CLIENTS)/.clients
	$(CLIENTS)/bin/python -m pytest --slow tests/clients

# The contract over every environment on a GPU, or a simulated one: that takes 20 minutes of a core.
test-cuda: $(VENV)/.dev
	$(BIN)/python -m pytest -n $(CORES) --exhaustive --simulated-gpu -rs tests/contract -k TestGpu

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(VENV)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/.dev
	$(BIN)/pearl bench steps CliffWalking --n-agents 43008 --out $(OUT)/bench
	$(BIN)/python -m pytest --benchmark-enable --benchmark-only tests/benchmarks/bench_*.py

# Whole trainings beside those of other packages, three seeds of each: leave the machine alone meanwhile.
bench-peers: $(PEERS)/.peers
	$(PEERS)/bin/pearl bench training --out $(OUT)/bench

# Pages about all environments, of what stands in their folders.
tables: $(VENV)/.dev
	mkdir -p $(OUT)
	$(BIN)/pearl envs --markdown > $(OUT)/environments.txt
	$(BIN)/python -m experiments.environment_figures > $(OUT)/environment_figures.txt
	for page in environments environment_figures; do \
	  sed -i '/to the last line. -->$$/q' docs/$$page.md; \
	  { echo; cat $(OUT)/$$page.txt; } >> docs/$$page.md; \
	done

# Every table and figure of the paper, measured here, as a page. Takes hours; started again, it goes on.
figures: $(VENV)/.report
	$(BIN)/pearl report --out $(OUT)/report

# A bitstream for a Radiona ULX3S, with the timing met; other sizes and boards: docs/boards.md.
ulx3s: $(VENV)/.rtl
	$(BIN)/pearl board ulx3s CliffWalking --n-envs 1024 --out $(OUT)/ulx3s

# The documentation as a site; to look at it: python -m http.server -d out/site
docs: export NO_MKDOCS_2_WARNING := 1
docs: $(VENV)/.docs
	$(BIN)/python -m mkdocs build --strict --site-dir $(OUT)/site

# The site in a browser. It takes a Chromium: Debian's package, or `.venv/bin/playwright install chromium`.
test-docs: $(VENV)/.browser
	$(BIN)/python -m pytest --slow -rs tests/docs/test_site.py

# What a release has, built and installed where nothing else is.
dist: $(VENV)/.dev
	.ci/dist $(BIN)/python

clean:
	rm -rf $(VENV) $(RLLIB) $(TORCHRL) $(PEERS) $(CLIENTS) $(OUT) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks

# One stamp for each set of extras; asking for more adds to the same environment. Python compiles what is imported, when
# it is; to compile all that is installed would take most of a minute. uv installs several packages at a time, and knows
# none of pip's settings: it is told where pip finds files, and where it fails, as behind a proxy that only pip knows of,
# pip takes over.
$(VENV)/.render: EXTRAS := render
$(VENV)/.rtl: EXTRAS := rtl
$(VENV)/.report: EXTRAS := report
$(VENV)/.dev: EXTRAS := report,cuda,ray,marl,dev
$(VENV)/.docs: EXTRAS := docs
$(VENV)/.browser: EXTRAS := docs,browser,testing
$(VENV)/.render $(VENV)/.rtl $(VENV)/.report $(VENV)/.dev $(VENV)/.docs $(VENV)/.browser: $(PACKAGE) | $(BIN)/python
	@echo "Installing pearl-marl[$(EXTRAS)] into $(VENV), in a minute or more ..."
	@$(PIP) uv
	@UV_FIND_LINKS="$$(echo $${PIP_FIND_LINKS-$$($(BIN)/python -m pip config get global.find-links 2>&-)} | tr ' ' ,)" \
		$(BIN)/uv pip install --python $(BIN)/python -c constraints.txt -e '.[$(EXTRAS)]' || $(PIP) -e '.[$(EXTRAS)]'
	@touch $@

$(RLLIB)/.rllib: $(PACKAGE)
	@echo "Installing pearl-marl[rllib] into $(RLLIB) ..."
	@$(PYTHON) -m venv $(RLLIB)
	@sed '/^gymnasium==/d' constraints.txt > $(RLLIB)/constraints.txt
	@$(RLLIB)/bin/python -W ignore -m pip install --quiet --disable-pip-version-check -c $(RLLIB)/constraints.txt \
		-e '.[rllib,testing]' pytest-benchmark
	@touch $@

$(TORCHRL)/.torchrl: $(PACKAGE)
	@echo "Installing pearl-marl[torchrl] with TorchRL 0.14 into $(TORCHRL) ..."
	@$(PYTHON) -m venv $(TORCHRL)
	@sed 's/^torchrl==.*/torchrl==0.14.1/; s/^tensordict==.*/tensordict==0.14.3/' constraints.txt > $(TORCHRL)/constraints.txt
	@$(TORCHRL)/bin/python -W ignore -m pip install --quiet --disable-pip-version-check \
		-c $(TORCHRL)/constraints.txt -e '.[torchrl,testing]'
	@touch $@

$(PEERS)/.peers: $(PACKAGE)
	@echo "Installing pearl-marl[peers] into $(PEERS) ..."
	@$(PYTHON) -m venv $(PEERS)
	@sed 's/^gymnasium==.*/gymnasium==1.3.0/' constraints.txt > $(PEERS)/constraints.txt
	@$(PEERS)/bin/python -W ignore -m pip install --quiet --disable-pip-version-check \
		-c $(PEERS)/constraints.txt -e '.[peers,testing]' pytest-benchmark
	@touch $@

$(CLIENTS)/.clients: $(PACKAGE) tests/clients/requirements.txt
	@echo "Installing pearl-marl[train,marl] with what trains on it into $(CLIENTS) ..."
	@$(PYTHON) -m venv $(CLIENTS)
	@$(CLIENTS)/bin/python -W ignore -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt \
		-e '.[train,marl,testing]' pytest-benchmark supersuit pandas scipy
	@$(CLIENTS)/bin/python -W ignore -m pip install --quiet --disable-pip-version-check --no-compile --no-deps \
		-r tests/clients/requirements.txt
	@$(CLIENTS)/bin/python -W ignore -c 'import imitation, joblib, skrl, supersuit, tianshou'
	@touch $@

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Python 3.11 or later is needed, $(PYTHON) is $$($(PYTHON) --version): make PYTHON=python3.12" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
