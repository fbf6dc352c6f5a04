"""Triangle meshes for ray tracing: bounding volume hierarchy, shading normals, watertightness."""
