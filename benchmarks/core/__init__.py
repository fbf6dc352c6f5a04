"""The benchmarks of docs/performance.md: benchmarks/against_peers.py."""
