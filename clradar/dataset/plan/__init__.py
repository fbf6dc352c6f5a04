"""Plans of data sets, and the recipes of samples that follow from them."""

from clradar.versions import require_own

require_own("measurement_io")  # not a file of that name beside the script that runs
