"""HDF5 files in confined processes (`clradar.files.confined`)."""
