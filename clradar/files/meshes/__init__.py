"""Files of triangle meshes, read in a confined process."""
