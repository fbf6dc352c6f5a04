"""Hostile input for every reader of `measurement_io`: see docs/fuzzing.md.

`targets` says what is read, `seeds` and the `mutate_*` modules make the inputs, `oracle` says what
may come of one, `worker` reads many of them in a process of its own and `campaign` watches it.
"""
