"""Limits of files that are not trusted: every reader takes its own from here.

docs/untrusted-files.md has the policy: which library or parser reads what, in which process.
"""

from __future__ import annotations

MAX_HOLES_BYTES = 2**28
"""Of a file that are not on disk: with holes a small file is of any size, and takes any time."""

# ---- text
MAX_MESSAGE_CHARACTERS = 400
"""Of a foreign message that is passed on; a damaged file can make one of any length."""
MAX_JSON_BYTES = 16 * 2**20
"""JSON of recordings and of `meta`, read or written; other attributes of HDF5 files."""
MAX_JSON_DEPTH = 64  # nesting of lists and mappings
MAX_TOML_BYTES = 2**18  # layouts, poses, mappings of rigs, materials
MAX_LONG_TOML_BYTES = 2**21
"""Plans of data sets and antenna arrays: they can list thousands of poses or antennas."""
MAX_TOML_LINE_CHARACTERS = 2**14
"""A key of thousands of dotted parts keeps the parser busy for minutes."""
MAX_ANTENNA_FILE_BYTES = 2**20

# ---- arrays
MAX_DIMENSIONS = 32  # of an array, as in numpy
MAX_ARRAY_BYTES = 2**29
"""Most that one key of a lab's file may take in memory, after single frames were picked."""
MAX_LISTS_BYTES = 2**26  # of positions, frequencies and the like, beside the one key with the data
MAX_LOADED_BYTES = 2**30
"""Of one key of an archive or of a MATLAB v5 file, before single frames are picked."""

# ---- files of labs (`measurement_io.layouts`)
MAX_KEYS = 10_000
MAX_NESTING = 16  # of groups and structs
MAX_CHANNELS = 100_000
MAX_CHUNK_BYTES = 2**28  # of an HDF5 dataset: HDF5 holds a chunk twice, as stored and inflated

# ---- HDF5, read in a process of its own (`clradar.files.confined`)
CPU_LIMIT_S = 3
"""Processor time for reading a file, and as much again for every `CPU_LIMIT_BYTES` of it and
every `CPU_LIMIT_INFLATED_BYTES` that may come back, which a small file can hold compressed."""
CPU_LIMIT_BYTES = 2**26
CPU_LIMIT_INFLATED_BYTES = 2**28
START_LIMIT_S = 60  # wall time to start a process
WALL_FACTOR = 20
"""Wall time after that, per second of processor time: slow disks read 1 MB/s. Windows, which does
not limit processor time, has 2."""
MEMORY_BYTES = 2**30  # memory that reading may take on top of twice the content
MAX_ANSWER_HEADER_BYTES = 2**28

# ---- pickles
MAX_FRAME_BYTES = 2**30  # a recorded frame: 96 x 96 channels at 7281 frequencies in complex128
MAX_TIME_STAMPS = 100_000
MAX_PICKLE_OPERATIONS = 2_000_000
"""A frame and a hand model need some hundreds; a long list of time stamps fits, too."""
MAX_SPARSE_ELEMENTS = 2**24
"""Of a sparse matrix with its zeros: 16 joints of a hand of a million vertices."""

# ---- images, points, meshes and rigs
MAX_IMAGE_PIXELS = 2**24  # of a PNG image: 4096 x 4096
MAX_PNG_BYTES = 2 * MAX_IMAGE_PIXELS + 2**20  # the pixels as they are, and a little for the form
MAX_MESH_BYTES = 2**29
"""Of a file of a mesh or rig, and of what it inflates to. A hand of a million vertices needs a
tenth of it; scans carry large textures, too."""
MAX_MESH_BUFFERS_BYTES = 2**28  # of all files beside a `.gltf`
MAX_MESH_FACES = 2**23  # triangles of a mesh, with all instances
MAX_MESH_VERTICES = 2**24
MAX_MESH_PARTS = 2**16  # objects, groups, primitives, with all instances
MAX_MESH_NODES = 2**17  # nodes of a glTF scene
MAX_MESH_DEPTH = 1000  # levels of these nodes: a chain of all of them would take trimesh minutes
MAX_GLTF_OBJECTS = 40_000  # of the JSON of a rig: pygltflib takes seconds for so many
MAX_GLTF_NUMBERS = 2**26
"""Numbers taken from a rig in glTF, as often as they are used: some need no bytes of it."""
MESH_CPU_S = 10
"""Processor time for reading a mesh or rig, and a second more for every `MESH_CPU_BYTES`."""
MESH_CPU_BYTES = 2**19
MESH_MEMORY_BYTES = 2**31
"""Memory that reading a mesh or rig may take, and `MESH_MEMORY_FACTOR` times the file."""
MESH_MEMORY_FACTOR = 20  # text takes most: OFF was measured to take 19 times the file
MAX_RIG_ANSWER_BYTES = 2**32
"""A rig as it comes back: of a million vertices, influences of 0.4 GB and pose blends of 3.2 GB."""
