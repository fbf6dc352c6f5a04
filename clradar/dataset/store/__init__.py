"""Data sets on disk: parts, shards, index, checks, repair."""
