"""The phasor sum: from path lengths to frequency samples."""
