"""Recordings of the 94 x 94 imager in the folder form of the MAROON dataset."""
