"""Formulas that others derived, and what clradar gives for them: docs/validation.md.

`mie`, `optics` and `gaussian` are programs of their own in numpy and scipy that import nothing of
clradar; `measured` runs clradar; the others compare; `python -m truths` writes the page.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "support"))  # where this is run as a program
