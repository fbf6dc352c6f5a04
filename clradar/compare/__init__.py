"""Comparison of images: metrics, where two images disagree, and their spread over seeds."""
