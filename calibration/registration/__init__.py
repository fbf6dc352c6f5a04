"""Rigid registration of images and meshes to a measured image."""
