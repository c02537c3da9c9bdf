"""Configuration files that people write: one loader, one validator, errors with file, line and key path.

loader  YAML text to values that know their line; which command a file is for; Python objects that a file names
scalars what a plain scalar means, wherever one is written
values  `ConfigValue`: a value, its key path and its line; methods that check it; dataclasses of parameters
"""
