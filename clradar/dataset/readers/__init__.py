"""Readers of data sets: lazy xarray arrays, and a map-style data set for PyTorch."""
