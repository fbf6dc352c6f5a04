"""The phasor sum: path lengths to frequency samples."""
