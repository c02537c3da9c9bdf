"""Reads .bpmn files into the neutral model of `fame.bpmn.model`, and writes them back."""

from fame.bpmn.reader.document import read, read_bytes, read_text, write

__all__ = ["read", "read_bytes", "read_text", "write"]
