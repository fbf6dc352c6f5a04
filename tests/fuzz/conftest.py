"""Inputs are tried in processes that are limited and measured as Linux alone can."""

import sys

collect_ignore_glob = [] if sys.platform == "linux" else ["test_*.py"]
