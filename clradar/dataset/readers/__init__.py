"""Data sets as xarray and as PyTorch see them."""
