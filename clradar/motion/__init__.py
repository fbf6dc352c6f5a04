"""Scenes that move while a sweep is recorded, and from frame to frame; docs/movement.md."""
