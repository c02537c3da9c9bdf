"""The parts that a drawing is made of; `fame.bpmn.draw` puts them together."""
