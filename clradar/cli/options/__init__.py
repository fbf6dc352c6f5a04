"""How commands declare options, and the groups of options that several of them have."""

from clradar.cli.groups import *  # noqa: F403
from clradar.cli.options.measured import *  # noqa: F403
from clradar.cli.options.scene import *  # noqa: F403
