"""The conventions a capture was written in: sign, axes, array order."""
