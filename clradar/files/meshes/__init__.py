"""Files of triangle meshes, read in a confined process; glTF also for rigs."""
