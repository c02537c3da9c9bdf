"""Configuration files that people write: YAML with line numbers, and what a file is for."""
