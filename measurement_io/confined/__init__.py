"""Reading HDF5 in a process of its own, with limits."""
