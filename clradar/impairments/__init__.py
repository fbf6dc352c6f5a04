"""Measurement effects: noise, channel errors, environment."""
