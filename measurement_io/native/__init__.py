"""The native HDF5 files of captures, volumes and channel calibrations."""
