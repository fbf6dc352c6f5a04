"""Readers are watched and measured as Linux alone can, and start no process for every file."""

import os
import sys

here = sys.platform == "linux" and os.getenv("CLRADAR_READERS") != "spawn"
collect_ignore_glob = [] if here else ["test_*.py"]
