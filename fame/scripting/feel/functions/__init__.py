"""All functions of FEEL by name: those of DMN 1.5 (section 10.3.4) and of Camunda 8. docs/feel.md lists them."""

from fame.scripting.feel.functions.collections import COLLECTIONS, CONTEXTS
from fame.scripting.feel.functions.dates import MOMENTS
from fame.scripting.feel.functions.numbers import NUMBERS, RANGES
from fame.scripting.feel.functions.strings import TEXTS

FUNCTIONS = NUMBERS | TEXTS | COLLECTIONS | CONTEXTS | MOMENTS | RANGES
"""Name -> its signatures."""
