"""FEEL (DMN 1.5, chapter 10), the expressions of Camunda 8.

=================================  ==================================================
language                           the dialect: its operators and what operands begin with
lists, lambdas                     the syntax of lists, contexts, iterations; of functions
types                              ``instance of``
values, times                      what values are: comparisons; dates and durations
functions                          the table of all functions, from the modules below
numbers, texts, collections,       the functions, by what they are about; `patterns` are
contexts, moments, ranges,         the regular expressions of those about texts
patterns
=================================  ==================================================
"""

from fame.scripting.feel.language import FEEL

__all__ = ["FEEL"]
