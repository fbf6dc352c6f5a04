"""Confined processes, in which libraries read files that may be damaged or hostile."""
