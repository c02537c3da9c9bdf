// What ends a finding of `fame check`, done as a person would: it can be undone.

/** @typedef {{text: string, element: string, kind: string, value: string, name: string, instead: string}} Fix */

/** The extension properties of an element in the dialect of the file. */
function setProperty(modeler, element, { name, value, instead }) {
  const factory = modeler.get("bpmnFactory");
  const vendor = modeler.get("moddle").getPackage("zeebe") ? "zeebe" : "camunda";
  const { businessObject } = element;
  const old = businessObject.extensionElements?.values ?? [];
  const holder = old.find((one) => one.$type === `${vendor}:Properties`);
  const list = vendor === "zeebe" ? "properties" : "values";
  const kept = (holder?.get(list) ?? []).filter((one) => ![name, instead].includes(one.name));
  const properties = factory.create(`${vendor}:Properties`, {
    [list]: [...kept, factory.create(`${vendor}:Property`, { name, value })],
  });
  const extensionElements = factory.create("bpmn:ExtensionElements", {
    values: [...old.filter((one) => one !== holder), properties],
  });
  modeler.get("modeling").updateProperties(element, { extensionElements });
}

/** The signal, message or error that an event or a task refers to gets a value. */
function setReferred(modeler, element, reference, values) {
  const { businessObject } = element;
  const definition = [...(businessObject.eventDefinitions ?? []), businessObject].find((one) => one[reference]);
  if (definition) modeler.get("modeling").updateModdleProperties(element, definition[reference], values);
}

/** A condition in the language that the model has, or none. */
function setCondition(modeler, element, body) {
  const conditionExpression = body && modeler.get("bpmnFactory").create("bpmn:FormalExpression", { body });
  modeler.get("modeling").updateProperties(element, { conditionExpression: conditionExpression || undefined });
}

/** A boundary event that catches an error, and an end event behind it. */
function addCatcher(modeler, element, errorCode) {
  const [modeling, factory, shapes] = ["modeling", "bpmnFactory", "elementFactory"].map((one) => modeler.get(one));
  const type = "bpmn:BoundaryEvent";
  const event = shapes.createShape({ type, eventDefinitionType: "bpmn:ErrorEventDefinition" });
  const place = { x: element.x + element.width - 25, y: element.y + element.height };
  const catcher = modeling.createShape(event, place, element, { attach: true });
  const [definition] = catcher.businessObject.eventDefinitions;
  const { rootElements } = modeler.getDefinitions();
  const known = rootElements.find((one) => one.$type === "bpmn:Error" && one.errorCode === errorCode);
  const errorRef = known ?? factory.create("bpmn:Error", { name: errorCode, errorCode });
  if (!known) {
    errorRef.$parent = modeler.getDefinitions();
    const properties = { rootElements: [...rootElements, errorRef] };
    modeling.updateModdleProperties(catcher, modeler.getDefinitions(), properties);
  }
  modeling.updateModdleProperties(catcher, definition, { errorRef });
  modeler.get("autoPlace").append(catcher, shapes.createShape({ type: "bpmn:EndEvent" }));
}

/** @type {{[kind: string]: (modeler: any, element: any, fix: Fix) => void}} */
const KINDS = {
  property: setProperty,
  default: (modeler, element, { value }) =>
    modeler
      .get("modeling")
      .updateProperties(element, { default: modeler.get("elementRegistry").get(value).businessObject }),
  condition: (modeler, element, { value }) => setCondition(modeler, element, value),
  catcher: (modeler, element, { value }) => addCatcher(modeler, element, value),
  message: (modeler, element, { value }) => setReferred(modeler, element, "messageRef", { name: value }),
  signal: (modeler, element, { value }) => setReferred(modeler, element, "signalRef", { name: value }),
  error: (modeler, element, { value }) => setReferred(modeler, element, "errorRef", { errorCode: value }),
};

const MEND = "fame.mend";
const known = new WeakSet();

/**
 * Change what a fix says, as one step that can be undone.
 *
 * @param {any} modeler @param {Fix} fix
 */
export function mend(modeler, fix) {
  const [stack, elements] = [modeler.get("commandStack"), modeler.get("elementRegistry")];
  if (!known.has(modeler)) stack.register(MEND, { preExecute: ({ work }) => work() });
  known.add(modeler);
  const element = elements.get(fix.element);
  if (element) stack.execute(MEND, { work: () => KINDS[fix.kind](modeler, element, fix) });
}
