"""Triangle meshes as the kernels read them: bounding volume hierarchy, normals, closedness."""
