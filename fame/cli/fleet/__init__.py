"""Commands for robots in the field: ``fame doctor``, ``inventory``, ``unit`` and ``log collect``."""
