"""Data sets on disk: parts, shards, manifest, verification, repair."""

from clradar.versions import require_own

require_own("measurement_io")  # not a file of that name beside the script that runs
