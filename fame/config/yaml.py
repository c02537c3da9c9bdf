"""YAML files as plain data: whatever is wrong with the text is one error of FAME, with its line where that is known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fame.errors import ConfigError


def read_document(path: str | Path) -> Any:
    """The data of a YAML file. Raises ConfigError."""
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", file=str(path)) from None
    except UnicodeDecodeError:
        raise ConfigError("is no UTF-8 text", file=str(path)) from None
    return parse_document(text, str(path))


def parse_document(text: str, file: str = "") -> Any:
    """The data of a YAML text. Raises ConfigError, also for a key that is given twice, of which YAML takes the last."""
    import yaml

    try:
        loader = yaml.SafeLoader(text)
        node = loader.get_single_node()
        if node is None:
            return None
        _refuse_twice(node, file, set())
        return loader.construct_document(node)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 0
        raise ConfigError(f"is no YAML: {error.problem or error.context}", file=file, line=line) from None
    except (yaml.YAMLError, ValueError) as error:  # ValueError: of numbers and dates that cannot be
        raise ConfigError(f"is no YAML: {error}", file=file) from None
    except RecursionError:
        raise ConfigError("is nested too deeply; a few levels would be right", file=file) from None
    except (LookupError, AttributeError, TypeError, OverflowError):  # PyYAML's own, of `!!bool maybe` and its like
        raise ConfigError("is no YAML: found a tag (!!...) whose value is of another kind", file=file) from None


def _refuse_twice(node: Any, file: str, seen: set[int]) -> None:
    """Raises ConfigError for a key that stands twice in one mapping."""
    import yaml

    if id(node) in seen:  # an alias, which may contain itself
        return
    seen.add(id(node))
    if isinstance(node, yaml.MappingNode):
        keys: set[str] = set()
        for key, value in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value != "<<":
                if key.value in keys:
                    raise ConfigError("is given twice", file=file, line=key.start_mark.line + 1, element=key.value)
                keys.add(key.value)
            _refuse_twice(value, file, seen)
    elif isinstance(node, yaml.SequenceNode):
        for item in node.value:
            _refuse_twice(item, file, seen)
