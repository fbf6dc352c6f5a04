"""Hostile input for every reader of `measurement_io`: see docs/fuzzing.md.

`targets` lists the readers, `seeds` and the `mutate_*` modules make the inputs, `oracle` judges the
outcomes, `worker` reads many inputs in a process of its own and `campaign` watches it.
"""
