"""Diagnosis of a capture's conventions: phase sign, axis order, frequency order, handedness."""
