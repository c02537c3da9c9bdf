"""Exploring the states of a scenario or a model with its number of robots, and the page about that."""
