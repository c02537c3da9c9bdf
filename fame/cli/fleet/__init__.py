"""Commands for robots in the field: ``fame doctor``, ``inventory`` and ``log collect``."""
