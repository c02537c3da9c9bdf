"""Models as people draw them in many tools, before anything can be executed: made of features, with their drawing.

A feature is a piece of BPMN that is well-formed and that tools write, and why it cannot be executed, if it cannot.
Files are made of some of them at random, in the looks of some tool: prefixes, encodings, vendors' extensions, odd
drawings.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from random import Random

from lxml import etree

BPMN = "http://www.omg.org/spec/BPMN/20100524/MODEL"
_DI = {
    "bpmndi": "http://www.omg.org/spec/BPMN/20100524/DI",
    "dc": "http://www.omg.org/spec/DD/20100524/DC",
    "di": "http://www.omg.org/spec/DD/20100524/DI",
}
_XSI = "http://www.w3.org/2001/XMLSchema-instance"


@dataclass(frozen=True, slots=True)
class Feature:
    """`content` stands in a process, `root` beside it ({n} is a number of its own); `refused`: what is said of it."""

    content: str
    refused: str = ""
    root: str = ""


def _catch(definition: str) -> str:
    return f'<intermediateCatchEvent id="c{{n}}" name="Wait {{n}}">{definition}</intermediateCatchEvent>'


def _loop(inside: str, attributes: str = "") -> str:
    loop = f"<multiInstanceLoopCharacteristics {attributes}>{inside}</multiInstanceLoopCharacteristics>"
    return f'<userTask id="t{{n}}" name="Each {{n}}">{loop}</userTask>'


def _flow(condition: str, attributes: str = "") -> str:
    said = f"<conditionExpression {attributes}>{condition}</conditionExpression>"
    return (
        '<task id="a{n}"/><task id="b{n}"/>'
        f'<sequenceFlow id="f{{n}}" sourceRef="a{{n}}" targetRef="b{{n}}">{said}</sequenceFlow>'
    )


_NO_TIME, _NO_CONDITION = "the timer has no time", "the conditional event has no condition"
_NO_ITEMS = "neither a collection nor a cardinality"
_LANGUAGE = "expected python"

FEATURES: dict[str, Feature] = {
    # what is not said yet
    "a timer without a time": Feature(_catch("<timerEventDefinition/>"), _NO_TIME),
    "a timer with an empty date": Feature(_catch("<timerEventDefinition><timeDate/></timerEventDefinition>"), _NO_TIME),
    "a timer at a boundary": Feature(
        '<task id="t{n}"/><boundaryEvent id="b{n}" attachedToRef="t{n}"><timerEventDefinition id="d{n}"/>'
        "</boundaryEvent>",
        _NO_TIME,
    ),
    "a condition that is empty": Feature(
        _catch("<conditionalEventDefinition><condition/></conditionalEventDefinition>"), _NO_CONDITION
    ),
    "a condition that is missing": Feature(_catch("<conditionalEventDefinition/>"), _NO_CONDITION),
    "a multi-instance": Feature(_loop(""), _NO_ITEMS),
    "a multi-instance in turn": Feature(_loop("", 'isSequential="true"'), _NO_ITEMS),
    "a multi-instance sub-process": Feature(
        '<subProcess id="s{n}" name="Many"><multiInstanceLoopCharacteristics/></subProcess>', _NO_ITEMS
    ),
    "a loop without an end": Feature(
        '<task id="t{n}"><standardLoopCharacteristics testBefore="false"/></task>', "a condition or a maximum"
    ),
    "a call of nothing": Feature('<callActivity id="t{n}" name="Call"/>', "has no called element"),
    "a link without a name": Feature(
        '<intermediateThrowEvent id="l{n}"><linkEventDefinition/></intermediateThrowEvent>', "the link has no name"
    ),
    "a compensation event without a handler": Feature(
        '<task id="t{n}"/><boundaryEvent id="b{n}" attachedToRef="t{n}"><compensateEventDefinition/></boundaryEvent>',
        "needs one handler",
    ),
    # languages
    "a script in Groovy": Feature(
        '<scriptTask id="t{n}" scriptFormat="groovy"><script>x = 1</script></scriptTask>', _LANGUAGE
    ),
    "a script in MVEL": Feature(
        '<scriptTask id="t{n}" scriptFormat="http://www.mvel.org/2.0"><script>x</script></scriptTask>', _LANGUAGE
    ),
    "a condition in Java": Feature(_flow("return a;", 'language="http://www.java.com/java"'), _LANGUAGE),
    "a condition in words": Feature(_flow("amount is too high"), "invalid syntax"),
    "a condition in FEEL": Feature(_flow("=x &gt; 3", 'language="https://www.omg.org/spec/DMN/20191111/FEEL/"')),
    "a condition as a resource": Feature(
        _flow("", 'xmlns:camunda="http://camunda.org/schema/1.0/bpmn" camunda:resource="a.groovy"'),
        "is the resource a.groovy",
    ),
    "a transformation in Java": Feature(
        '<property id="p{n}" name="q{n}"/><property id="r{n}" name="v{n}"/><task id="t{n}"><dataInputAssociation '
        'id="d{n}"><sourceRef>p{n}</sourceRef><targetRef>r{n}</targetRef><transformation language="java">x'
        "</transformation></dataInputAssociation></task>",
        _LANGUAGE,
    ),
    # names
    "signals without a name": Feature(
        '<intermediateThrowEvent id="e{n}"><signalEventDefinition signalRef="S{n}"/></intermediateThrowEvent>',
        root='<signal id="S{n}"/>',
    ),
    "a signal of nothing": Feature(
        '<intermediateThrowEvent id="e{n}"><signalEventDefinition/></intermediateThrowEvent>'
    ),
    "a signal that is not there": Feature(
        '<intermediateThrowEvent id="e{n}"><signalEventDefinition signalRef="gone"/></intermediateThrowEvent>',
        "signalRef 'gone': the file has no such signal",
    ),
    "a message without a name": Feature(
        '<intermediateThrowEvent id="e{n}"><messageEventDefinition messageRef="M{n}"/></intermediateThrowEvent>',
        root='<message id="M{n}"/>',
    ),
    "an error that is not there": Feature(
        '<task id="t{n}"/><boundaryEvent id="b{n}" attachedToRef="t{n}"><errorEventDefinition errorRef="gone"/>'
        "</boundaryEvent>",
        "errorRef 'gone': the file has no such error",
    ),
    "items with blanks": Feature(
        _loop(
            "<loopCardinality>2</loopCardinality>"
            '<inputDataItem id="i{n}" name="input item"/><outputDataItem id="o{n}" name="output item"/>'
        )
    ),
    "data with blanks": Feature(
        '<ioSpecification id="io{n}"><dataInput id="in{n}" name="Order form"/><dataOutput id="_1-{n}" name="Bill"/>'
        "<inputSet/><outputSet/></ioSpecification>"
    ),
    "data inside an event": Feature(
        '<dataStoreReference id="store{n}" name="Employee Details"/><intermediateThrowEvent id="e{n}" name="new">'
        '<dataInput id="_d-{n}" name="Employee Details"/><dataInputAssociation id="da{n}"><sourceRef>store{n}'
        "</sourceRef><targetRef>_d-{n}</targetRef></dataInputAssociation><inputSet><dataInputRefs>_d-{n}"
        "</dataInputRefs></inputSet><signalEventDefinition/></intermediateThrowEvent>"
    ),
    # what hangs in the air
    "a flow to nothing": Feature(
        '<task id="t{n}"/><sequenceFlow id="f{n}" sourceRef="t{n}" targetRef="gone"/>', "there is no such flow node"
    ),
    "a flow without ends": Feature('<sequenceFlow id="f{n}"/>', "the sequence flow has no sourceRef"),
    "a flow across a border": Feature(
        '<subProcess id="s{n}"><task id="in{n}"/></subProcess><task id="t{n}"/>'
        '<sequenceFlow id="f{n}" sourceRef="t{n}" targetRef="in{n}"/>',
        "it crosses the boundary of its scope",
    ),
    "a flow out of an end": Feature(
        '<endEvent id="e{n}"/><task id="t{n}"/><sequenceFlow id="f{n}" sourceRef="e{n}" targetRef="t{n}"/>'
    ),
    "a boundary event of nothing": Feature(
        '<boundaryEvent id="b{n}" attachedToRef="gone"><errorEventDefinition/></boundaryEvent><task id="t{n}"/>'
        '<sequenceFlow id="f{n}" sourceRef="b{n}" targetRef="t{n}"/>',
        "there is no such activity in its scope",
    ),
    "a boundary event of a gateway": Feature(
        '<exclusiveGateway id="g{n}"/><boundaryEvent id="b{n}" attachedToRef="g{n}"><timerEventDefinition/>'
        "</boundaryEvent>",
        "which is not an activity",
    ),
    "a default that leads elsewhere": Feature(
        '<exclusiveGateway id="g{n}" default="gone"/>', "is not one of those that leave it"
    ),
    "data that is not there": Feature(
        '<task id="t{n}"><dataInputAssociation id="d{n}"><sourceRef>gone</sourceRef><targetRef>gone</targetRef>'
        "</dataInputAssociation></task>",
        "the process has no such data object",
    ),
    "an assignment of nothing": Feature(
        '<property id="p{n}" name="q{n}"/><task id="t{n}"><dataInputAssociation id="d{n}"><targetRef>p{n}</targetRef>'
        "<assignment><from/><to>x</to></assignment></dataInputAssociation></task>",
        "an assignment needs from and to",
    ),
    # what cannot be there, or is not known
    "a timer at the end": Feature('<endEvent id="e{n}"><timerEventDefinition/></endEvent>', "cannot be end events"),
    "an unknown event": Feature('<endEvent id="e{n}"><fooEventDefinition/></endEvent>', "unknown event definition"),
    "an unknown element": Feature('<choreographyTask id="t{n}" name="Agree"/>', "not a flow element that FAME knows"),
    "an element of no BPMN": Feature('<v:shape xmlns:v="http://vendor" id="v{n}"/>'),
    "a truth of a tool": Feature('<userTask id="t{n}" isForCompensation="FALSE "/>', "expected true or false"),
    # the rest of BPMN
    "a sub-process of events": Feature(
        '<subProcess id="s{n}" triggeredByEvent="true"><startEvent id="ss{n}" isInterrupting="false">'
        "<timerEventDefinition><timeCycle/></timerEventDefinition></startEvent></subProcess>",
        _NO_TIME,
    ),
    "a transaction": Feature(
        '<transaction id="s{n}" method="##Compensate"><task id="t{n}"/></transaction><boundaryEvent id="b{n}" '
        'attachedToRef="s{n}"><cancelEventDefinition/></boundaryEvent>'
    ),
    "an ad-hoc sub-process": Feature(
        '<adHocSubProcess id="s{n}" ordering="Parallel"><task id="t{n}"/></adHocSubProcess>'
    ),
    "a business rule": Feature('<businessRuleTask id="t{n}" implementation="##unspecified"/>', "business rules"),
    "a call of a global task": Feature(
        '<callActivity id="t{n}" calledElement="G{n}"/>',
        "it calls the <globalUserTask> G",
        root='<globalUserTask id="G{n}" name="Reusable" implementation="##WebService"/>',
    ),
    "gateways": Feature(
        '<complexGateway id="g{n}"/><eventBasedGateway id="h{n}" eventGatewayType="Exclusive" instantiate="false"/>'
        + _catch("<messageEventDefinition/>")
        + '<sequenceFlow id="f{n}" sourceRef="h{n}" targetRef="c{n}"/><sequenceFlow id="i{n}" sourceRef="g{n}" '
        'targetRef="h{n}" isImmediate="true"/>'
    ),
    "notes and groups": Feature(
        '<task id="t{n}"/><textAnnotation id="x{n}" textFormat="text/plain"><text>a note\nof two lines</text>'
        '</textAnnotation><association id="y{n}" sourceRef="t{n}" targetRef="x{n}" associationDirection="None"/>'
        '<group id="z{n}" categoryValueRef="cv{n}"/>',
        root='<category id="ca{n}" name="Phases"><categoryValue id="cv{n}" value="Phase 1"/></category>',
    ),
    "lanes in lanes": Feature(
        '<laneSet id="ls{n}"><lane id="la{n}" name="Outer"><flowNodeRef>gone</flowNodeRef><childLaneSet id="lc{n}">'
        '<lane id="li{n}" name="Inner"/><lane id="lj{n}"/></childLaneSet></lane></laneSet>'
    ),
    "data": Feature(
        '<dataObject id="do{n}" isCollection="true"><extensionElements/></dataObject><dataObjectReference id="dr{n}" '
        'name="Invoice" dataObjectRef="do{n}"><dataState id="ds{n}" name="paid"/></dataObjectReference>'
        '<dataStoreReference id="dt{n}" name="Files" dataStoreRef="DS{n}"/><task id="t{n}"><dataOutputAssociation '
        'id="oa{n}"><sourceRef>nowhere</sourceRef><targetRef>dr{n}</targetRef></dataOutputAssociation></task>',
        root='<dataStore id="DS{n}" name="Files" capacity="0" isUnlimited="false"/>',
    ),
    "a person": Feature(
        '<userTask id="t{n}" implementation="##unspecified" startQuantity="1" completionQuantity="1"><performer '
        'id="pf{n}" name="me"><resourceRef>R{n}</resourceRef></performer><potentialOwner id="po{n}"><resourceRef>R{n}'
        "</resourceRef><resourceAssignmentExpression><formalExpression>x</formalExpression>"
        '</resourceAssignmentExpression></potentialOwner><rendering id="re{n}"/></userTask>',
        root='<resource id="R{n}" name="Chef"><resourceParameter id="rp{n}" name="a" isRequired="false"/></resource>',
    ),
    "items and interfaces": Feature(
        '<serviceTask id="t{n}" name="Ask" implementation="##WebService" operationRef="O{n}"/>',
        root='<itemDefinition id="I{n}" itemKind="Information" structureRef="xsd:string"/><message id="N{n}" '
        'itemRef="I{n}"/><interface id="F{n}" name="Service"><operation id="O{n}" name="ask"><inMessageRef>N{n}'
        '</inMessageRef></operation></interface><endPoint id="EP{n}"/><partnerRole id="PR{n}" name="buyer"/>'
        '<import importType="http://www.w3.org/2001/XMLSchema" location="types.xsd" namespace="http://types"/>',
    ),
    "many triggers": Feature(
        '<intermediateCatchEvent id="c{n}" parallelMultiple="true"><timerEventDefinition/><messageEventDefinition/>'
        "</intermediateCatchEvent>",
        _NO_TIME,
    ),
}
VENDORS = {
    "signavio": ("http://www.signavio.com", '<v:signavioMetaData metaKey="bgcolor" metaValue="#ffffff"/>'),
    "bizagi": ("http://www.bizagi.com/bpmn20", "<v:BizagiExtensions><v:BizagiProperties/></v:BizagiExtensions>"),
    "trisotech": ("http://www.trisotech.com/2014/triso/bpmn", '<v:visual fill="#fff"/>'),
    "adonis": ("http://www.boc-eu.com/adonis", '<v:attribute name="Duration">00:00</v:attribute>'),
    "ibm": ("http://www.ibm.com/xmlns/bpmnx/20100524/BusinessVocabulary", '<v:data xml:space="preserve"> </v:data>'),
    "yaoqiang": ("http://bpmn.sourceforge.net", '<v:pageFormat height="841" width="598"/>'),
    "blank": ("http://Some Tool/model 1", "<v:thing>text</v:thing>"),
}
ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "iso-8859-1", "us-ascii")


def drawn_model(features: list[str], random: Random) -> bytes:
    """A file with these features in its processes, and all that tools write around them."""
    numbered = [(number, FEATURES[name]) for number, name in enumerate(features)]
    halves = numbered[::2], numbered[1::2]
    processes = [_process(f"P{place}", half) for place, half in enumerate(halves) if half]
    roots = "".join(feature.root.replace("{n}", str(number)) for number, feature in numbered)
    uri, extension = VENDORS[random.choice(list(VENDORS))]
    pools = random.choice([_pools(random, len(processes)), "", _pools(random, len(processes))])
    text = (
        f'<definitions xmlns="{BPMN}" xmlns:v="{uri}" id="D" targetNamespace="http://t" exporter="Ärger" '
        f"{random.choice(_LANGUAGES)}><extensionElements>{extension}</extensionElements>{roots}{pools}"
        f"{''.join(processes)}{random.choice(_BESIDE)}</definitions>"
    )
    root = etree.fromstring(text, etree.XMLParser(recover=True))
    root.append(_diagram(root, random))
    prefix = random.choice(["", "semantic", "bpmn2"])
    return _encoded(_with_prefix(root, prefix), random.choice(ENCODINGS))


_LANGUAGES = ("", 'expressionLanguage="http://www.w3.org/1999/XPath" typeLanguage="http://www.w3.org/2001/XMLSchema"')
_BESIDE = (
    "",
    '<choreography id="CH" isClosed="false"><participant id="CP" name="Buyer"/><participant id="CQ" name="Seller"/>'
    '<messageFlow id="CM" sourceRef="CP" targetRef="CQ"/><startEvent id="CS"/><choreographyTask id="CT" name="Order" '
    'initiatingParticipantRef="CP"><participantRef>CP</participantRef><participantRef>CQ</participantRef>'
    '<messageFlowRef>CM</messageFlowRef></choreographyTask><subChoreography id="CU" initiatingParticipantRef="CP"/>'
    '<exclusiveGateway id="CG"/><endEvent id="CE"/><sequenceFlow id="CF" sourceRef="CS" targetRef="CT"/></choreography>'
    '<globalChoreographyTask id="GC" initiatingParticipantRef="CP"/>',
    '<globalTask id="GT" name="x"/><globalScriptTask id="GS" scriptLanguage="groovy"><script>1</script>'
    '</globalScriptTask><relationship type="t"><source>a</source><target>b</target></relationship>',
)


def _process(id: str, features: list[tuple[int, Feature]]) -> str:
    inside = "".join(feature.content.replace("{n}", str(number)) for number, feature in features)
    inside += f'<startEvent id="start_{id}"/><task id="first_{id}" name="Größe"/>'
    inside += f'<sequenceFlow id="flow_{id}" sourceRef="start_{id}" targetRef="first_{id}"/>'
    return f'<process id="{id}" isExecutable="false" processType="None" isClosed="false">{inside}</process>'


def _pools(random: Random, count: int) -> str:
    names = ["Pizza Customer", "", "REX"]
    random.shuffle(names)
    pools = "".join(f'<participant id="pool{i}" name="{names[i]}" processRef="P{i}"/>' for i in range(count))
    flows = ['<messageFlow id="mf" sourceRef="black" targetRef="first_P0"/>',
             '<messageFlow id="mf" sourceRef="black" targetRef="gone"/>', ""]  # fmt: skip
    talk = (
        '<conversation id="cv" name="Talk"><participantRef>black</participantRef></conversation><subConversation '
        'id="sc"/><callConversation id="cc"/><conversationLink id="cl" sourceRef="black" targetRef="cv"/>'
    )
    more = '<collaboration id="C2"><participant id="other" name="Else" processRef="nowhere"/></collaboration>'
    return (
        f'<collaboration id="C" isClosed="false">{pools}<participant id="black" name="Vendor"><participantMultiplicity '
        f'minimum="2" maximum="2"/></participant>{random.choice(flows)}{random.choice(["", talk])}</collaboration>'
        f"{random.choice(['', '', more])}"
    )


def _diagram(root: etree._Element, random: Random) -> etree._Element:
    """Shapes in a grid, edges across, and a few that cannot be drawn."""
    shown = root.find(f"{{{BPMN}}}collaboration")
    holder = shown if shown is not None else root.find(f"{{{BPMN}}}process")
    assert holder is not None
    parts = "".join(_parts(root, random))
    declared = " ".join(f'xmlns:{prefix}="{uri}"' for prefix, uri in _DI.items())
    return etree.fromstring(
        f'<bpmndi:BPMNDiagram {declared} id="diagram" name="Page 1" resolution="96.0"><bpmndi:BPMNPlane id="plane" '
        f'bpmnElement="{holder.get("id")}">{parts}</bpmndi:BPMNPlane><bpmndi:BPMNLabelStyle id="style"><dc:Font '
        'name="Arial" size="11.0"/></bpmndi:BPMNLabelStyle></bpmndi:BPMNDiagram>'
    )


def _parts(root: etree._Element, random: Random) -> Iterator[str]:
    bounds = '<dc:Bounds x="{}" y="{}" width="90" height="60"/>'
    points = '<di:waypoint x="0" y="0"/><di:waypoint x="50.5" y="70"/>'
    for place, one in enumerate(one for one in root.iter(f"{{{BPMN}}}*") if one.get("id")):
        tag, around = one.tag.rpartition("}")[2], f'id="di_{place}" bpmnElement="{one.get("id")}"'
        if tag.endswith(("Flow", "ssociation", "Link")):
            yield f"<bpmndi:BPMNEdge {around}>{points}<bpmndi:BPMNLabel/></bpmndi:BPMNEdge>"
        elif not tag.endswith(("Definition", "Characteristics", "process", "definitions", "collaboration", "Set")):
            box = bounds.format(place % 9 * 120, place // 9 * 90)
            band = 'participantBandKind="bottom_non_initiating"' if one.get("id") == "CQ" else ""
            label = '<bpmndi:BPMNLabel labelStyle="style"/>'
            yield f'<bpmndi:BPMNShape {around} {band} isHorizontal="true">{box}{label}</bpmndi:BPMNShape>'
    odd = (
        '<bpmndi:BPMNEdge id="o1" bpmnElement="flow_P0"><di:waypoint x="1" y="1"/></bpmndi:BPMNEdge>',
        '<bpmndi:BPMNEdge id="o2" bpmnElement="flow_P0"/>',
        '<bpmndi:BPMNShape id="o3" bpmnElement="first_P0"/>',
        '<bpmndi:BPMNShape id="o4" bpmnElement="first_P0"><dc:Bounds x="NaN" y="0" width="1" height="1"/>'
        "</bpmndi:BPMNShape>",
        f'<bpmndi:BPMNShape id="o5" bpmnElement="nothing">{bounds.format(1, 1)}</bpmndi:BPMNShape>',
        f'<bpmndi:BPMNShape id="o6">{bounds.format(1, 1)}</bpmndi:BPMNShape>',
        f'<bpmndi:BPMNShape id="o7" bpmnElement="first_P0" isExpanded="maybe">{bounds.format(1, 1)}</bpmndi:BPMNShape>',
    )
    yield from random.sample(odd, random.randrange(3))


def _with_prefix(root: etree._Element, prefix: str) -> str:
    """The same document with another prefix for BPMN."""
    text = etree.tostring(root, encoding="unicode")
    if not prefix:
        return text
    others = {name: uri for name, uri in root.nsmap.items() if name}
    declared = "".join(f' xmlns:{name}="{uri}"' for name, uri in {**others, prefix: BPMN, "xsi": _XSI}.items())
    written = []
    for one in root.iter():
        name = one.tag.rpartition("}")[2]
        if one.tag == f"{{{BPMN}}}{name}":
            written.append(name)
    for name in sorted(set(written)):
        for before, after in (("<", " "), ("<", ">"), ("<", "/"), ("</", ">")):
            text = text.replace(f"{before}{name}{after}", f"{before}{prefix}:{name}{after}")
    text = text.replace(f' xmlns="{BPMN}"', "")
    for name, uri in others.items():
        text = text.replace(f' xmlns:{name}="{uri}"', "")
    return text.replace(f"<{prefix}:definitions", f"<{prefix}:definitions{declared}", 1)


def _encoded(text: str, encoding: str) -> bytes:
    declared = encoding.removesuffix("-sig")
    return f'<?xml version="1.0" encoding="{declared}"?>\n{text}'.encode(encoding, "xmlcharrefreplace")
