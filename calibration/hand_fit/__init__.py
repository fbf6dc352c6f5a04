"""Fit of a posed hand to a measured image: joint angles, shape, place, brightness and alpha."""
