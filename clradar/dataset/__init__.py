"""Training data: from a plan to shards of samples, each of which can be made again alone."""
