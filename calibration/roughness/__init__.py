"""Estimation of the roughness parameter alpha."""
