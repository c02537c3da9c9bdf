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

/** The signal or error that an event refers to gets a value. */
function setReferred(modeler, element, reference, values) {
  const definition = element.businessObject.eventDefinitions?.find((one) => one[reference]);
  if (definition) modeler.get("modeling").updateModdleProperties(element, definition[reference], values);
}

/** @type {{[kind: string]: (modeler: any, element: any, fix: Fix) => void}} */
const KINDS = {
  property: setProperty,
  default: (modeler, element, { value }) =>
    modeler
      .get("modeling")
      .updateProperties(element, { default: modeler.get("elementRegistry").get(value).businessObject }),
  signal: (modeler, element, { value }) => setReferred(modeler, element, "signalRef", { name: value }),
  error: (modeler, element, { value }) => setReferred(modeler, element, "errorRef", { errorCode: value }),
};

/** @param {any} modeler @param {Fix} fix */
export function mend(modeler, fix) {
  const element = modeler.get("elementRegistry").get(fix.element);
  if (element) KINDS[fix.kind](modeler, element, fix);
}
