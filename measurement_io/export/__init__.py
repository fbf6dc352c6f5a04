"""Captures, volumes and depth maps in files that other programs open."""
