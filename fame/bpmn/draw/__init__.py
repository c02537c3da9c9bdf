"""The parts that a drawing is made of; `fame.bpmn.draw.diagram` puts them together."""
