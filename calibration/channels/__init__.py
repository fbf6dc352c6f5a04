"""Estimation and correction of channel errors."""
