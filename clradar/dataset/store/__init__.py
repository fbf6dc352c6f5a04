"""Data sets on disk: parts, shards, manifest, verification, repair."""
