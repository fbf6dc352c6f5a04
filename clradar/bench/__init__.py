"""The benchmarks of docs/performance.md: `clradar bench`."""
