"""Rigid registration of meshes and images to a measured image."""
