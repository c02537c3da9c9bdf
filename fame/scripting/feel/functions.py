"""All functions of FEEL: those of DMN 1.5 (section 10.3.4) and of Camunda 8, by name. docs/feel.md lists them."""

from __future__ import annotations

from fame.scripting.feel.collections import COLLECTIONS
from fame.scripting.feel.contexts import CONTEXTS
from fame.scripting.feel.moments import MOMENTS
from fame.scripting.feel.numbers import NUMBERS
from fame.scripting.feel.ranges import RANGES
from fame.scripting.feel.texts import TEXTS

FUNCTIONS = NUMBERS | TEXTS | COLLECTIONS | CONTEXTS | MOMENTS | RANGES
"""Name -> its signatures."""
