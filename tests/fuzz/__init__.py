"""Inputs that somebody damaged on purpose, for every reader of bytes that others wrote.

`mutations` damages valid input, `targets` lists the readers, `trial` says what an input did to one.
`python -m tests.fuzz` runs for as long as it is told; `found` holds what once failed.
"""
