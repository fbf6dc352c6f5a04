"""Impairments: noise, channel errors, drift and static echoes of a real measurement."""
