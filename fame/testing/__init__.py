"""Tests of missions, in the terms of the model and in simulated time: a pytest plugin (docs/testing.md).

The fixture ``mission`` loads a model or a scenario::

    def test_the_helper_follows(mission):
        m = mission.load("patrol.yaml")
        m.run_until("HELPER", at="Go To")
        m.expect("SCOUT").passed("Go To").before("Green light")
        m.expect("HELPER").completed(within=60)

::

    plugin        options and fixture of pytest, the report of a failed test
    preload        what is imported before the first test
    mission        a mission under test: driving it
    by_hand        a mission that runs step by step
    manual_robots  the robots of such a mission
    expectations   expectations of a robot
    failure        the text and the files of a failed expectation
    report_folder  the report of tests as a folder, with pages of what failed
    late_recording  the recording of a mission, written when it is wanted
    trace          the events of a mission by element
    elements       elements of a model by label or id
    fakes          fake topics, services, actions and people
    series         messages of fake topics from files
    stubs          behaviours that a test replaces
    coverage       elements and flows that tests have entered
    explored_runs  runs of an exploration on real engines, and as tests
    strategies     strategies of hypothesis: networks, faults, free places, messages
"""

from typing import TYPE_CHECKING

from fame.imports import attach

if TYPE_CHECKING:
    from fame.testing.expectations import Expectation as Expectation
    from fame.testing.failure import ExpectationError as ExpectationError
    from fame.testing.fakes import FakeAction as FakeAction, FakeService as FakeService, FakeTopic as FakeTopic
    from fame.testing.mission import MissionLoader as MissionLoader, MissionUnderTest as MissionUnderTest
else:
    __getattr__, __dir__, __all__ = attach(__name__)
