"""Over a topic a task of a running robot is completed, an element of an ad-hoc sub-process begun: once, or refused."""

import pytest
from deployment_field import Field

from fame import deploy
from fame.cli.robots import rows
from fame.deploy import Report
from fame.deploy.requests import TaskClient, TaskRequest
from fame.middleware import messages

MODEL = (
    '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" targetNamespace="t"><process id="p">'
    '<startEvent id="s"/><userTask id="ask"/><manualTask id="lift"/>'
    '<sequenceFlow id="f" sourceRef="s" targetRef="ask"/><sequenceFlow id="g" sourceRef="ask" targetRef="lift"/>'
    "</process></definitions>"
)


AD_HOC = (
    '<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" targetNamespace="t"><process id="p">'
    '<startEvent id="s"/><adHocSubProcess id="chores"><userTask id="look"/><scriptTask id="photo"><script>photos = 1'
    '</script></scriptTask></adHocSubProcess><sequenceFlow id="f" sourceRef="s" targetRef="chores"/></process>'
    "</definitions>"
)


REQUIRED = '<camunda:validation><camunda:constraint name="required"/></camunda:validation></camunda:formField>'
FORM = MODEL.replace("<definitions", '<definitions xmlns:camunda="http://camunda.org/schema/1.0/bpmn"').replace(
    '<userTask id="ask"/>',
    '<userTask id="ask"><extensionElements><camunda:formData><camunda:formField id="note" type="string"/>'
    f'<camunda:formField id="bags" type="long">{REQUIRED}<camunda:formField id="order.to" type="string">{REQUIRED}'
    "</camunda:formData></extensionElements></userTask>",
)


class Floor(Field):
    """A robot with an engine, and a person beside it."""

    def __init__(self, model: str = MODEL) -> None:
        super().__init__("REX")
        self.engine = self.engines["REX"]
        if model:
            self.say("bpmn_process", model)

    def say(self, topic: str, text: str) -> None:
        end = self.person.publisher(f"/REX/{topic}", deploy.STRING)
        end.publish(messages.create(deploy.STRING, text))
        self.pass_time(0.1)

    def complete(self, element: str, **values) -> list[Report]:
        return self.ask(TaskRequest(id=f"request {element}", element=element, values=values))

    def activate(self, element: str) -> list[Report]:
        return self.ask(TaskRequest(id=f"begin {element}", element=element, act="activate"))

    def ask(self, done: TaskRequest) -> list[Report]:
        answers: list[Report] = []
        asking = TaskClient("REX", done, node=self.person, scheduler=self.scheduler, answered=answers.append)
        self.pass_time(2)
        asking.close()
        return answers

    @property
    def waiting(self) -> list[str]:
        return self.engine.running.instances[-1].waiting


def test_a_task_is_done_with_its_results_and_the_token_goes_on():
    floor = Floor()
    (answer,) = floor.complete("ask", approved=True, height=1.5)
    assert (answer.answer, answer.reason) == ("completed", "")
    assert floor.waiting == ["lift"]
    assert floor.engine.running.instances[-1].variables == {"approved": True, "height": 1.5}
    floor.complete("lift")
    assert floor.engine.running.instances[-1].status == "completed"


def test_a_form_without_what_it_requires_is_told_and_the_token_goes_on():
    floor = Floor(FORM)
    (answer,) = floor.complete("ask", note="none")
    assert (answer.answer, answer.reason) == ("completed", "ask; without bags, order.to, which its form requires")
    assert floor.waiting == ["lift"]


@pytest.mark.parametrize("known", ["given", "set"])
def test_what_a_form_requires_may_be_a_variable_already(known: str):
    floor, given = Floor(FORM), {"bags": 2, "order": {"to": "gate"}}
    if known == "set":
        floor.engine.running.set_variables(given)
    (answer,) = floor.complete("ask", **(given if known == "given" else {}))
    assert (answer.answer, answer.reason) == ("completed", "")


SIGNED = MODEL.replace(
    '<userTask id="ask"/>',
    '<userTask id="ask"><multiInstanceLoopCharacteristics><loopCardinality>3</loopCardinality>'
    "</multiInstanceLoopCharacteristics></userTask>",
)


def test_of_several_the_answer_says_that_it_was_the_first():
    floor = Floor(SIGNED)
    answers = [floor.ask(TaskRequest(id=f"{number}", element="ask"))[0] for number in range(3)]
    assert [answer.answer for answer in answers] == ["completed"] * 3
    assert [answer.reason for answer in answers] == ["ask: the first of 3 there", "ask: the first of 2 there", ""]
    assert floor.waiting == ["lift"]


@pytest.mark.parametrize("act", ["skip", "restart", "move"])
def test_what_is_inside_of_the_first_is_none_of_its_own(act: str):
    floor = Floor(SIGNED)
    (answer,) = floor.ask(TaskRequest(id="1", element="ask", act=act, to="lift" if act == "move" else ""))
    assert (answer.answer, answer.reason) == ({"skip": "skipped", "restart": "restarted", "move": "moved"}[act], "")
    assert floor.waiting == (["ask"] * 3 if act == "restart" else ["lift"])


@pytest.mark.parametrize("act", ["skip", "restart", "move"])
def test_of_two_tokens_a_repair_takes_the_first_and_says_so(act: str):
    twice = '<sequenceFlow id="f2" sourceRef="s" targetRef="ask"/><sequenceFlow id="f" sourceRef'
    floor = Floor(MODEL.replace('<sequenceFlow id="f" sourceRef', twice))
    (answer,) = floor.ask(TaskRequest(id="1", element="ask", act=act, to="lift" if act == "move" else ""))
    assert answer.reason == "ask: the first of 2 there"


def test_a_variable_that_nothing_had_is_named():
    floor = Floor()
    first, again = (floor.ask(TaskRequest(id=id, element="", act="set", values={"sped": 1})) for id in "ab")
    assert [each.reason for each in (*first, *again)] == ["sped; not a variable before: sped", ""]


def test_where_no_task_waits_the_answer_names_what_does():
    floor = Floor()
    (answer,) = floor.complete("lift")
    assert answer.answer == "refused"
    assert "lift: is not waiting; currently waiting: ask" in answer.reason
    assert floor.waiting == ["ask"]


def test_a_label_with_a_slip_is_answered_with_what_was_meant():
    floor = Floor(MODEL.replace('<userTask id="ask"', '<userTask id="ask" name="Messwert prüfen"'))
    (answer,) = floor.complete("Messwert pruefen")
    said = "Messwert pruefen: the mission has no such element; did you mean 'Messwert prüfen'?"
    assert (answer.answer, answer.reason.endswith(said)) == ("refused", True), answer.reason


def test_an_element_is_named_by_its_label_if_only_one_has_it():
    labelled = MODEL.replace('"ask"/>', '"ask" name="Confirm&#10;it"/>').replace('"lift"/>', '"lift" name="Lift it"/>')
    floor = Floor(labelled)
    (moved,) = floor.ask(TaskRequest(id="1", element="Confirm it", act="move", to="Lift it"))
    (back,) = floor.ask(TaskRequest(id="2", element="lift", act="move", to="Confirm it"))
    (done,) = floor.complete("Confirm it")
    assert [moved.answer, back.answer, done.answer, floor.waiting] == ["moved", "moved", "completed", ["lift"]]
    (answer,) = Floor(labelled.replace("Lift it", "Confirm it")).complete("Confirm it")
    assert (answer.answer, answer.reason.endswith("is the label of ask, lift: use an id")) == ("refused", True)


def test_a_robot_without_a_process_refuses():
    (answer,) = Floor(model="").complete("ask")
    assert (answer.answer, answer.reason) == ("refused", "ask: the robot has no process yet")


def test_the_same_words_twice_are_one_completion_and_two_answers():
    floor = Floor(MODEL.replace('targetRef="lift"', 'targetRef="ask"'))
    before = floor.engine.running.instances[-1].visits["ask"]
    said = TaskRequest(id="one", element="ask", values={}).to_json()
    floor.say("bpmn_task", said)
    floor.say("bpmn_task", said)
    assert floor.engine.running.instances[-1].visits["ask"] == before + 1
    assert [report.answer for report in floor.said if report.deployment == "one"] == ["completed", "completed"]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        '{"id": 1, "element": "ask", "values": {}}',
        '{"id": "a", "element": "ask", "values": {"__x": 1}}',
        '{"id": "a", "element": "ask", "act": "dance"}',
        '{"id": "a", "element": "ask", "act": "activate", "values": {"x": 1}}',
        '{"id": "a", "element": "ask", "act": ["activate"]}',
    ],
)
def test_what_is_no_task_is_refused_and_touches_nothing(text):
    floor = Floor()
    floor.say("bpmn_task", text)
    assert floor.said[-1].answer == "refused"
    assert floor.said[-1].reason.startswith("no task")
    assert floor.waiting == ["ask"]


def test_a_robot_that_hears_late_is_told_again():
    floor = Floor(model="")
    floor.engine.close()
    answers: list[Report] = []
    done = TaskRequest(id="one", element="ask", values={})
    TaskClient("REX", done, node=floor.person, scheduler=floor.scheduler, answered=answers.append)
    floor.pass_time(1)
    assert answers == []
    floor.add("REX")
    floor.say("bpmn_process", MODEL)
    floor.pass_time(1)
    assert len(answers) == 1


def test_an_element_of_an_ad_hoc_sub_process_is_activated_once_more():
    floor = Floor(AD_HOC)
    (answer,) = floor.activate("photo")
    assert (answer.answer, answer.reason) == ("activated", "")
    (instance,) = floor.engine.running.instances
    assert instance.visits["photo"] == 2
    floor.complete("look")
    assert instance.status == "completed"


def test_a_report_says_what_could_be_activated_as_long_as_the_sub_process_is_open():
    floor = Floor(AD_HOC)
    assert floor.said[-1].offers == ["look", "photo"]
    shown = [" ".join(cells).strip() for cells in rows("REX", floor.said[-1])]
    assert shown[-1] == "fame activate REX: look, photo"
    floor.complete("look")
    assert floor.said[-1].offers == []


def test_what_cannot_be_activated_is_refused_with_what_could():
    floor = Floor(AD_HOC)
    (answer,) = floor.activate("chores")
    assert answer.answer == "refused"
    assert answer.reason.endswith("can start: look, photo")
    (answer,) = Floor(model="").activate("photo")
    assert (answer.answer, answer.reason) == ("refused", "photo: the robot has no process yet")


def test_the_same_words_twice_activate_once():
    floor = Floor(AD_HOC)
    said = TaskRequest(id="one", element="photo", act="activate").to_json()
    floor.say("bpmn_task", said)
    floor.say("bpmn_task", said)
    assert floor.engine.running.instances[0].visits["photo"] == 2
