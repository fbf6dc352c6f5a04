"""Recorded captures and the native HDF5 file, as records of `clradar`; files for others."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
