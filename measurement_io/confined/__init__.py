"""Confined processes, in which HDF5 files are read with limits of memory and time."""
