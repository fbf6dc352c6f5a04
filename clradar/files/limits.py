"""Limits of files that are not trusted: every reader takes its own from here.

docs/untrusted-files.md has the policy: which library or parser reads what, in which process.
"""

from __future__ import annotations

MAX_MESSAGE_CHARACTERS = 400
"""Of a foreign message that is passed on; a damaged file can make one of any length."""

MAX_JSON_BYTES = 16 * 2**20
"""JSON of recordings and of `meta`, read or written."""

MAX_SMALL_JSON_BYTES = 2**20
"""JSON of a matrix, of joints, of settings."""

MAX_JSON_DEPTH = 64
"""Nesting of lists and mappings."""

MAX_TOML_BYTES = 2**18
"""Layouts, poses, mappings of rigs."""

MAX_PLAN_BYTES = 2**20
"""Plans of data sets: they can list thousands of poses."""

MAX_RIG_BYTES = 2**29
"""A hand of a million vertices needs a tenth of it; scans carry large pictures, too."""

MAX_TOML_LINE_CHARACTERS = 2**13
"""A key of thousands of dotted parts keeps the parser busy for minutes."""

MAX_PICKLE_OPERATIONS = 2_000_000
"""A frame and a hand model need some hundreds; a long list of time stamps fits, too."""

MAX_DIMENSIONS = 32
"""Of an array, as in numpy."""

MAX_SPARSE_ELEMENTS = 2**24
"""Of a sparse matrix with its zeros: 16 joints of a hand of a million vertices."""

MAX_IMAGE_PIXELS = 2**24
"""Of a PNG image: 4096 x 4096."""

MAX_PNG_BYTES = 2 * MAX_IMAGE_PIXELS + 2**20
"""The pixels as they are, and a little for the form."""
